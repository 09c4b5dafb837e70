"""Titles and names as text of a comment: no title can become a part of a file's program."""

from __future__ import annotations

# Beside letters and digits of any script. Without quotes, backslashes, stars, question marks, semicolons, brackets and
# percent signs nothing ends or opens a comment, a string, a section or a file in any of the controllers' languages: not
# */ or its spliced and trigraph forms in C, not *) in Structured Text, not ]]> in XML, not ) in G-code, not % in Fanuc.
KEPT = " _-.,:+/^"


def plain(text: str) -> str:
    """A text on one line, each sign that a language could read as its own replaced by a space."""
    return " ".join("".join(c if c.isalnum() or c in KEPT else " " for c in text).split())
