"""errpipe: raw machine-tool measurements in, verified compensation tables out."""

__version__ = "0.1.0"
