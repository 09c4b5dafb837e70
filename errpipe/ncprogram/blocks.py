"""One line of an NC program: its words, comments, line number and block delete mark."""

from __future__ import annotations

import re
from dataclasses import dataclass

from errpipe.errors import DataError

MAX_LINE = 4096  # characters; LinuxCNC reads 255 of them
_WORD = re.compile(r"([A-Za-z])[ \t]*([+-]?(?:\d+\.?\d*|\.\d+))", re.ASCII)
_COMMENT = re.compile("[();]")
_CONTROL = re.compile("[\x00-\x08\x0a-\x1f\x7f\x85\u2028\u2029]")
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

    def has(self, letters: str) -> bool:
        """Whether a word of any of these letters stands in the block."""
        return any(w.letter in letters for w in self.words)

    def refused(self, why: str) -> DataError:
        """The refusal of the block's line."""
        return refuse(self.line, self.source, why)


def refuse(line: int, source: str, why: str) -> DataError:
    """The one form in which a line is refused."""
    shown = source.strip()
    shown = shown if len(shown) <= 80 else shown[:77] + "..."
    return DataError(f"line {line}: {why}: {shown!r}. The program was left as it is.")


def parse(line: int, source: str) -> Block:
    """Read one line. Raises DataError for expressions, parameters, ragged words and unclosed comments."""
    if len(source) > MAX_LINE:
        raise refuse(line, source, f"a line of {len(source)} characters (at most {MAX_LINE})")
    if _CONTROL.search(source):
        raise refuse(line, source, "a control character in the line")
    text = source.strip(" \t")
    delete = text.startswith("/")
    text, comments = _comments(line, source, text[1:] if delete else text)
    if text.strip() == "%" and not comments and not delete:
        return Block(line, source)
    for mark, what in _REFUSED.items():
        if mark in text:
            raise refuse(line, source, f"{what} is not understood")
    words = [Word(m[1].upper(), float(m[2]), m[0].strip()) for m in _WORD.finditer(text)]
    rest = _WORD.sub(" ", text).strip(" \t")
    if rest:
        raise refuse(line, source, f"{rest[:40]!r} is not a word")
    number = next((w.text for w in words if w.letter == "N"), "")
    letters = [w.letter for w in words if w.letter not in "GM"]
    if len(set(letters)) != len(letters):
        raise refuse(line, source, "a word occurs twice")
    return Block(line, source, tuple(w for w in words if w.letter != "N"), number, comments, delete)


def _is_block(text: str) -> bool:
    """Whether a text is nothing but words, one of a G code or an axis among them."""
    letters = {m[1].upper() for m in _WORD.finditer(text)}
    return bool(letters & set("GXYZABC")) and not _WORD.sub("", text).strip(" \t;")


def _comments(line: int, source: str, text: str) -> tuple[str, tuple[str, ...]]:
    """The text without its comments, and these. What follows a semicolon outside brackets is one comment."""
    if not _COMMENT.search(text):
        return text, ()
    kept: list[str] = []
    comments, at = [], 0
    while at < len(text):
        if text[at] == ";":
            if "".join(kept).strip() and _is_block(text[at + 1 :]):
                why = (
                    "a control that ends blocks with ';' takes what follows as a block: one block a line, or (comment)"
                )
                raise refuse(line, source, why)
            comments.append(text[at:])
            break
        if text[at] == "(":
            end = text.find(")", at)
            if end < 0 or "(" in text[at + 1 : end]:
                raise refuse(line, source, "a comment that is not closed")
            comments.append(text[at : end + 1])
            kept.append(" ")
            at = end + 1
        elif text[at] == ")":
            raise refuse(line, source, "a comment that is not closed")
        else:
            kept.append(text[at])
            at += 1
    return "".join(kept), tuple(comments)
