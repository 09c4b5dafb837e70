"""Arithmetic only: floats and arrays in canonical units in, arrays out.

A kernel calls only kernels of its own file: with a cache on disk Numba does not notice an edit in
another file and would go on using the old code. `kernel` is the one decorator of the project.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


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
    return ""


if "NUMBA_CACHE_DIR" not in os.environ:
    os.environ["NUMBA_CACHE_DIR"] = _cache_folder() or tempfile.gettempdir()

import numba  # noqa: E402  (the cache folder must be known before Numba reads its settings)


def kernel(function):
    """njit with the house settings: no fast-math (bits are compared), IEEE division, cached."""
    return numba.njit(cache=True, fastmath=False, error_model="numpy", nogil=True)(function)
