"""Arithmetic only: floats and arrays in canonical units in, arrays out.

A kernel calls only kernels of its own file: with a cache on disk Numba does not notice an edit in
another file and would go on using the old code. `kernel` is the one decorator of the project.

Numba takes 0.4 s to import, so it waits for the first call: then every kernel of that file is turned
into its dispatcher at once (they may call each other), and later calls go straight there.
"""

from __future__ import annotations

import functools
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any


def _cache_folder() -> str:
    """A writable cache folder: the user's, else one below the temporary folder (containers without a home)."""
    from platformdirs import user_cache_dir

    own = Path(tempfile.gettempdir()) / f"errpipe-numba-{os.getuid()}"
    for folder in (Path(user_cache_dir("errpipe")) / "numba", own):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return str(folder)
        except OSError:
            continue
    return tempfile.gettempdir()


class Kernel:
    """A function that Numba compiles at its first call. `compiled` is the dispatcher, `py_func` the source."""

    def __init__(self, function: Callable[..., Any]):
        self.py_func = function
        functools.update_wrapper(self, function)

    @functools.cached_property
    def compiled(self) -> Any:
        names = self.py_func.__globals__
        for name, value in list(names.items()):
            if isinstance(value, Kernel):
                names[name] = value._dispatcher
        return self._dispatcher

    @functools.cached_property
    def _dispatcher(self) -> Any:
        if "NUMBA_CACHE_DIR" not in os.environ:
            os.environ["NUMBA_CACHE_DIR"] = _cache_folder()
        import numba

        return numba.njit(cache=True, fastmath=False, error_model="numpy", nogil=True)(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        return self.compiled(*arguments)


def kernel(function: Callable[..., Any]) -> Kernel:
    """njit with the house settings: no fast-math (bits are compared), IEEE division, cached, compiled when called."""
    return Kernel(function)
