"""Text from outside in a page of Markdown."""

from __future__ import annotations


def plain_text(text: object) -> str:
    """Text with Markdown markup escaped: labels come from the recording."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|!" else c for c in " ".join(str(text).split()))
