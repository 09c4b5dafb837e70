"""Canonical JSON out, whole files only, and the fingerprint of a value.

Equal values give equal bytes: keys sorted, floats in shortest round-trip form, UTF-8, one newline at
the end. NaN and infinity are refused: a reader on a controller would not know them.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from errpipe import files
from errpipe.errors import VerifyError

MOST_OBJECTS = (
    100_000  # in a document, and keys in one of them: a table has at most ten thousand nodes, pairs and terms
)


def dumps(value: Any, *, indent: int | None = 1) -> str:
    """Canonical text of `value`. Raises ValueError for NaN or infinity."""
    separators = (",", ":") if indent is None else (",", ": ")
    text = json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=False, indent=indent, separators=separators)
    return text + "\n"


def fingerprint(value: Any) -> str:
    """SHA-256 of the canonical text, as 64 hexadecimal digits."""
    return hashlib.sha256(dumps(value, indent=None).encode()).hexdigest()


def fingerprint_bytes(data: bytes) -> str:
    """SHA-256 of raw bytes, as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def write_bytes(path: Path, data: bytes) -> bool:
    """Write `data` whole (temporary file, fsync, rename), only if the bytes change. True if written."""
    path = Path(path)
    if path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data:
        return False
    with files.whole(path) as stream:
        stream.write(data)
    return True


def write_text(path: Path, text: str) -> bool:
    """`write_bytes` for UTF-8 text."""
    return write_bytes(path, text.encode())


def write(path: Path, value: Any) -> bool:
    """Write canonical JSON. True if the bytes changed."""
    return write_text(path, dumps(value))


def read(path: Path) -> Any:
    """Read a JSON file. Raises VerifyError naming line and column where it is not JSON."""
    return loads(files.read(Path(path), files.MAX_JSON_BYTES, VerifyError), path)


def loads(data: bytes, path: Path | str) -> Any:
    """What the bytes of a JSON file hold; path: its name in messages. Raises VerifyError as `read` does."""
    try:
        value = json.loads(data.decode())
    except json.JSONDecodeError as err:
        raise VerifyError(f"{path}:{err.lineno}:{err.colno}  not JSON: {err.msg}") from None
    except UnicodeDecodeError as err:
        raise VerifyError(f"{path}: not UTF-8 text at byte {err.start}") from None
    except RecursionError:
        raise VerifyError(f"{path}: not JSON that is read here: brackets nested too deep") from None
    except ValueError as err:  # a whole number of more digits than Python turns into a number
        raise VerifyError(f"{path}: not JSON that is read here: {str(err).split(';')[0].lower()}") from None
    if problem := _too_many(value):
        raise VerifyError(f"{path}: not JSON that is read here: {problem} (at most {MOST_OBJECTS})")
    return value


def _too_many(value: Any) -> str:
    """What there is too much of, in words; "" where nothing is. A check of each takes a thousand times its bytes."""
    objects = 0
    left: list[Any] = [value]
    while left:
        part = left.pop()
        if isinstance(part, dict):
            objects += 1
            if len(part) > MOST_OBJECTS or objects > MOST_OBJECTS:
                return (
                    f"more than {MOST_OBJECTS} objects" if objects > MOST_OBJECTS else f"an object of {len(part)} keys"
                )
            part = list(part.values())
        if isinstance(part, list):
            left += [x for x in part if isinstance(x, dict | list)]
    return ""
