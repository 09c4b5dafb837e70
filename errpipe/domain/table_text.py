"""What all parts of a compensation table share: their texts, as controllers can print them, and their base."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator, ConfigDict, Field

from errpipe.domain.recording import FrozenModel

# ASCII characters allowed in a text. Names are printed into programs, comments and file names of many
# controllers: no quote, star, semicolon, angle or curly bracket, backslash, question mark or the like is let through.
TITLE = (re.compile(r"[ -~\u0080-\U0010ffff]*"), "control characters are not allowed")
NAME = (
    re.compile(r"[A-Za-z0-9 _.:%/^()\[\]+\u0080-\U0010ffff-]*"),
    "allowed: letters, digits, spaces and _ - . : + % / ^ ( ) [ ]",
)
AXIS = (re.compile(r"[A-Za-z0-9]*"), "allowed: letters A to Z and digits")


def text_problem(value: str, longest: int, signs: tuple[re.Pattern[str], str] = NAME) -> str:
    """Why a text does not fit its zero-ended field of `longest` bytes of UTF-8; empty where it does."""
    allowed, says = signs
    try:
        size = len(value.encode())
    except UnicodeEncodeError:  # half a surrogate pair
        return f"{value!r} is not text"
    if size > longest:
        return f"{value!r} is longer than {longest} bytes"
    first_invalid = allowed.match(value).end()  # type: ignore[union-attr]  # it matches the empty text too
    return f"{value!r} holds {value[first_invalid]!r} ({says})" if first_invalid < len(value) else ""


def text(longest: int, signs: tuple[re.Pattern[str], str] = NAME) -> AfterValidator:
    """Validator of a text field; see `text_problem`."""

    def check(value: str) -> str:
        if problem := text_problem(value, longest, signs):
            raise ValueError(problem)
        return value

    return AfterValidator(check)


Name = Annotated[str, Field(min_length=1), text(31)]
Index = Annotated[int, Field(ge=0)]


class Part(FrozenModel):
    """A part of the table: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
