"""XML files of other programs: own entities, which can expand without limit, are rejected in any encoding."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from errpipe.errors import DataError


def root_of(path: Path, data: bytes) -> ElementTree.Element:
    """The root of a document. Raises DataError, with the line if known."""
    if re.search(rb"<!(DOCTYPE|ENTITY)", data.replace(b"\0", b"")):  # in UTF-16, every other byte is 0
        raise DataError(f"{path}: an XML file with its own entities is not read")
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as err:
        line = f":{err.position[0]} " if isinstance(err, ElementTree.ParseError) else ":"
        raise DataError(f"{path}{line} not XML that can be read ({err}): save it again, or export it as CSV") from None
