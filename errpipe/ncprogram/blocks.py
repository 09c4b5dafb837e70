"""One line of an NC program: its words, comments, line number and block delete mark."""

from __future__ import annotations

import re
from dataclasses import dataclass

from errpipe.errors import DataError

_WORD = re.compile(r"([A-Za-z])\s*([+-]?(?:\d+\.?\d*|\.\d+))")
_COMMENT = re.compile(r"\([^()]*\)")
_REFUSED = {"[": "an expression in brackets", "#": "a parameter", "{": "a template mark"}


@dataclass(frozen=True)
class Word:
    """A letter and its number, with the text as written."""

    letter: str
    value: float
    text: str

    @property
    def code(self) -> str:
        """The word as its bare code: G1, G43.1, M3."""
        return f"{self.letter}{self.value:g}"


@dataclass(frozen=True)
class Block:
    """One source line. words: in order, without N; comments: as written, with their marks."""

    line: int
    source: str
    words: tuple[Word, ...] = ()
    number: str = ""
    comments: tuple[str, ...] = ()
    delete: bool = False

    def value(self, letter: str) -> float | None:
        """Value of the only word of a letter, or None."""
        return next((w.value for w in self.words if w.letter == letter), None)

    def codes(self, letter: str) -> tuple[str, ...]:
        """All codes of a letter, such as ('G1', 'G90')."""
        return tuple(w.code for w in self.words if w.letter == letter)


def refuse(line: int, source: str, why: str) -> DataError:
    """The one form in which a line is refused."""
    return DataError(f"line {line}: {why}: {source.strip()!r}. The program was left as it is.")


def parse(line: int, source: str) -> Block:
    """Read one line. Raises DataError for expressions, parameters, O-words, ragged words and unclosed comments."""
    text = source.strip()
    delete = text.startswith("/")
    if delete:
        text = text[1:]
    comments = _COMMENT.findall(text)
    text = _COMMENT.sub(" ", text)
    if ";" in text:
        text, after = text.split(";", 1)
        comments.append(";" + after)
    if "(" in text or ")" in text:
        raise refuse(line, source, "a comment that is not closed")
    for mark, what in _REFUSED.items():
        if mark in text:
            raise refuse(line, source, f"{what} is not understood")
    words, rest = [], text
    for match in _WORD.finditer(text):
        words.append(Word(match.group(1).upper(), float(match.group(2)), match.group(0).strip()))
        rest = rest.replace(match.group(0), " ", 1)
    if rest.strip() not in ("", "%"):
        raise refuse(line, source, f"{rest.strip()!r} is not a word")
    if any(w.letter == "O" for w in words):
        raise refuse(line, source, "a subroutine or loop (O word) is not understood")
    number = next((w.text for w in words if w.letter == "N"), "")
    kept = tuple(w for w in words if w.letter != "N")
    letters = [w.letter for w in kept if w.letter not in "GM"]
    if len(set(letters)) != len(letters):
        raise refuse(line, source, "a word occurs twice")
    return Block(line, source, kept, number, tuple(comments), delete)
