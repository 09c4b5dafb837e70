"""Versions, compiler, extras, cache folder and threads: facts that a fault report should hold."""

from __future__ import annotations

import os
import platform
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "scikit-learn", "pydantic", "numba", "ruamel.yaml", "typer")
EXTRAS = {"excel": "python-calamine", "tdms": "npTDMS", "hdf": "h5py", "fmu": "FMPy", "dask": "dask"}


def doctor() -> dict[str, Any]:
    """Every fact by name, and lines to print; nothing is written but a file that is removed again."""
    from errpipe import __version__
    from errpipe.simulation.patch_fmu import c_compiler

    facts: dict[str, Any] = {"errpipe": __version__, "python": platform.python_version(), "system": platform.platform()}
    facts |= {name: _version(name) for name in PACKAGES}
    facts |= {f"extra {extra}": _version(package) for extra, package in EXTRAS.items()}
    facts["C compiler"] = c_compiler() or "none (exported C is then not compiled for its proof)"
    facts["cache folder"] = _cache()
    facts["threads"] = f"{os.cpu_count()} cores, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'not set')}"
    width = max(map(len, facts))
    return {**facts, "says": [f"{name:<{width}}  {value}" for name, value in facts.items()]}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _cache() -> str:
    from platformdirs import user_cache_dir

    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or user_cache_dir("errpipe"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return f"{folder} (can be written)"
    except OSError as err:
        return f"{folder} (cannot be written: {err.strerror}; code is then compiled again at every start)"
