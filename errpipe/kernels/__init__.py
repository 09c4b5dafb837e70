"""Arithmetic only: floats and arrays in canonical units in, arrays out. `kernel` is the one decorator of the project.

Compiled code is cached below a name that stands for the source of all kernels: Numba alone would not notice an edit in
another file than the caller's and would continue using the old code.

Numba takes 0.4 s to import, so it waits for the first call: then the kernel and every kernel that its module knows is
turned into its dispatcher (they may call each other), and later calls go straight there.
"""

from __future__ import annotations

import functools
import hashlib
import os
import stat
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any


def _cache_folder() -> str | None:
    """A folder for compiled code that nobody else can write, or None: what lies there is loaded as machine code.

    The user's cache folder, else one below the temporary folder (containers without a home).
    """
    from platformdirs import user_cache_dir

    for shared in (False, True):
        try:  # a full disk has no temporary folder either
            own = Path(tempfile.gettempdir()) / f"errpipe-numba-{os.getuid()}" if shared else None
            folder = own or Path(user_cache_dir("errpipe")) / "numba"
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            if _is_own(folder):
                return str(folder)
        except OSError:
            continue
    return None


def _is_own(folder: Path) -> bool:
    """Whether a folder is ours alone (made private where others could read) and no folder above can be swapped."""
    here = folder.lstat()
    if not stat.S_ISDIR(here.st_mode) or here.st_uid != os.getuid() or here.st_mode & 0o022:
        return False
    for above in folder.absolute().parents:
        facts = above.stat()
        if facts.st_uid not in (0, os.getuid()) or (facts.st_mode & 0o022 and not facts.st_mode & stat.S_ISVTX):
            return False
    if here.st_mode & 0o077:
        folder.chmod(0o700)
    return os.access(folder, os.W_OK)


@functools.cache
def _fingerprint() -> str:
    """Stands for the source of every kernel."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _in_cache(function: Callable[..., Any], folder: Path) -> Callable[..., Any]:
    """A kernel of this package as if its file lay in the cache; the function itself where that cannot be written.

    Numba files compiled code by the folder of its source. Every checkout, copy and new installation would compile the
    same kernels again, although `folder` stands for their source already.
    """
    source, place = Path(function.__code__.co_filename), (folder / "source").absolute()
    if not isinstance(function, FunctionType) or source.parent != Path(__file__).parent:
        return function
    try:
        place.mkdir(parents=True, exist_ok=True)
        if not (place / source.name).exists():
            copy = place / f"{source.name}.{os.getpid()}"
            copy.write_bytes(source.read_bytes())
            os.utime(copy, (0, 0))  # some versions of Numba compare times
            copy.replace(place / source.name)
    except OSError:
        return function
    code = function.__code__.replace(co_filename=str(place / source.name))
    twin = FunctionType(code, function.__globals__, function.__name__, function.__defaults__, function.__closure__)
    twin.__qualname__, twin.__module__, twin.__doc__ = function.__qualname__, function.__module__, function.__doc__
    twin.__annotations__ = function.__annotations__
    return twin


_SETTINGS = threading.RLock()  # Numba has one cache folder for all threads


class Kernel:
    """A function that Numba compiles at its first call. `compiled` is the dispatcher, `py_func` the source."""

    def __init__(self, function: Callable[..., Any], allocates: bool = True):
        self.py_func = function
        self.allocates = allocates
        functools.update_wrapper(self, function)

    @functools.cached_property
    def compiled(self) -> Any:
        _resolve(self.py_func.__globals__)
        return self._dispatcher

    @functools.cached_property
    def _dispatcher(self) -> Any:
        import numba

        folder = os.environ.get("NUMBA_CACHE_DIR") or _cache_folder()
        config: Any = numba.config
        with _SETTINGS:
            before = config.CACHE_DIR
            config.CACHE_DIR = str(Path(folder) / _fingerprint()) if folder else ""
            try:
                njit: Any = numba.njit  # its stubs do not know _nrt
                cached = folder is not None
                made = njit(cache=cached, fastmath=False, error_model="numpy", nogil=True, _nrt=self.allocates)
                return made(_in_cache(self.py_func, Path(config.CACHE_DIR)) if cached else self.py_func)
            finally:
                config.CACHE_DIR = before

    def __call__(self, *arguments: Any) -> Any:
        return self.compiled(*arguments)


def _resolve(names: dict[str, Any]) -> None:
    """Put dispatchers in place of the kernels among these names, and of those that they may call."""
    used = {name: value for name, value in names.items() if isinstance(value, Kernel)}
    names.update({name: value._dispatcher for name, value in used.items()})
    for value in used.values():
        if value.py_func.__globals__ is not names:
            _resolve(value.py_func.__globals__)


def bare_kernel(function: Callable[..., Any]) -> Kernel:
    """A kernel that makes no array: compiled without counting references, which costs a short loop half its time."""
    return Kernel(function, allocates=False)


def kernel(function: Callable[..., Any]) -> Kernel:
    """njit with common settings: no fast-math (bits are compared), IEEE division, cached, compiled when called."""
    return Kernel(function)
