"""Arrays of numpy (.npy, .npz): vectors are columns, also of structured arrays. Objects (pickles) are never loaded."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.sheet import ReaderOptions, Sheet
from errpipe.importing.structures import Node, put, sheets_of

name = "numpy"
suffixes = (".npy", ".npz")
binary = True
_NPY = b"\x93NUMPY"


def sniff(path: Path, head: bytes) -> bool:
    """An array of numpy, or a zip of them."""
    return head.startswith(_NPY) or (head.startswith(b"PK") and path.suffix.lower() == ".npz")


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """The sheets of a file, the largest first. Raises DataError for damaged files and for objects."""
    root = Node("")
    try:
        file = np.load(path, allow_pickle=False)
        for key in [path.stem] if isinstance(file, np.ndarray) else file.files:
            put(root, key, file if isinstance(file, np.ndarray) else file[key])
    except MemoryError:
        raise
    except Exception as err:  # numpy raises ValueError, EOFError, BadZipFile, ... for damaged files
        raise DataError(
            f"{path}: not arrays of numpy that can be read without running code in them ({type(err).__name__}): save "
            "numbers and texts without objects, or write CSV"
        ) from None
    return sheets_of(root, path, options.sheet)
