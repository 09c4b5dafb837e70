"""errpipe: raw machine-tool measurements in, verified compensation tables out.

From Python, `errpipe.read`, `fit`, `predict`, `diagnose`, `findings`, `recording`, `Table` are those of `errpipe.api`.
"""

__version__ = "0.1.0"

_API = ("Cycle", "Table", "diagnose", "findings", "fit", "predict", "read", "recording")


def __getattr__(name: str) -> object:
    """The Python interface, imported on first use: the command line does not wait for it."""
    if name in _API:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.api"), name)
    raise AttributeError(f"module 'errpipe' has no attribute {name!r} (it has: {', '.join(_API)})")
