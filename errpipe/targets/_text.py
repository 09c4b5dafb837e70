"""Text of files: titles and names as text of a comment (no title becomes a part of the program), templates, bytes."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jinja2

# Beside letters and digits of any script. Without quotes, backslashes, stars, question marks, semicolons, brackets and
# percent signs nothing ends or opens a comment, a string, a section or a file in any of the controllers' languages: not
# */ or its spliced and trigraph forms in C, not *) in Structured Text, not ]]> in XML, not ) in G-code, not % in Fanuc.
KEPT = " _-.,:+/^"


def plain(text: str) -> str:
    """A text on one line, each sign that a language could read as its own replaced by a space."""
    return " ".join("".join(c if c.isalnum() or c in KEPT else " " for c in text).split())


def ascii_text(text: str) -> str:
    """`plain` without accents, and with _ for other scripts and signs: not every control reads them in a comment."""
    letters = (c for c in unicodedata.normalize("NFD", text) if not unicodedata.combining(c))
    return plain("".join(c if c.isascii() else "_" for c in letters))


@cache
def _templates() -> jinja2.Environment:
    import jinja2

    return jinja2.Environment(
        loader=jinja2.PackageLoader("errpipe.targets"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        autoescape=False,
    )


def source(folder: str, name: str) -> str:
    """A text file of the package."""
    return resources.files("errpipe").joinpath(folder, name).read_text(encoding="utf-8")


def byte_rows(data: bytes, per_line: int, separator: str) -> str:
    """Bytes as decimal numbers, so many on a line."""
    return separator.join(", ".join(map(str, data[k : k + per_line])) for k in range(0, len(data), per_line))


def c_array(header: str, name: str, data: bytes) -> str:
    """Bytes as a C source file that includes the header with their declaration."""
    rows = byte_rows(data, 16, ",\n    ")
    return f'#include "{header}"\n\nconst uint8_t {name}[{len(data)}] = {{\n    {rows}}};\n'


def filled(template: str, facts: Mapping[str, Any]) -> str:
    """A template of the folder `templates` with its facts."""
    return _templates().get_template(template).render(facts)
