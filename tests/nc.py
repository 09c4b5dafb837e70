"""An NC program in one text, corrected: what `errpipe correct` does with a file, piece by piece."""

from __future__ import annotations

from typing import Any

from errpipe.ncprogram.correct import Deviation, Setup, Summary, rewrite


def correct(text: str, deviation: Deviation, setup: Setup, **how: Any) -> tuple[str, Summary]:
    """The corrected program and what was done."""
    parts: list[bytes] = []
    done = rewrite([text.encode()], parts.append, deviation, setup, **how)
    return b"".join(parts).decode(), done
