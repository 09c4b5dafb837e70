"""Everything errpipe refuses, and the exit code each refusal has.

ErrpipeError            1   never raised itself; anything outside this tree is a bug
|-- UsageError          2   the command line
|   `-- ConfigError     2   a configuration file: carries every problem of the file
|-- DataError           3   measurements that cannot be used
|   |-- NotIdentifiable 3   the data cannot distinguish two parameters
|   `-- MissingColumn   3   a model reads what the recording does not hold
|-- GateError           4   refused by a quality gate
`-- VerifyError         6   a file on disk is not what it claims to be

CHANGES_PENDING (5) is no error: `plan --exit-code` found stages to run.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

CHANGES_PENDING = 5  # exit code


class ErrpipeError(Exception):
    """Base of all refusals. `exit_code` is what the command line returns."""

    exit_code = 1


class UsageError(ErrpipeError):
    """The command line or an argument cannot be used."""

    exit_code = 2


@dataclass(frozen=True, order=True)
class Problem:
    """One thing wrong in one place. Lines and columns count from 1; 0 means unknown."""

    file: str
    line: int
    column: int
    key: str
    message: str

    def __str__(self) -> str:
        place = self.file
        if self.line:
            place += f":{self.line}" + (f":{self.column}" if self.column else "")
        return f"{place}  {self.key}: {self.message}" if self.key else f"{place}  {self.message}"


class ConfigError(UsageError):
    """A configuration file is wrong; `problems` holds everything found, in file order."""

    def __init__(self, problems: Sequence[Problem]):
        self.problems = tuple(sorted(problems))
        super().__init__("\n".join(map(str, self.problems)))


class DataError(ErrpipeError):
    """Measurements are rejected: the message says where, what was found, what is allowed."""

    exit_code = 3


class NotIdentifiable(DataError):
    """Two parameters cannot be distinguished on these data; the message names them."""


class MissingColumn(DataError, KeyError):
    """A column, axis or direction that a model reads is not in the recording."""

    def __str__(self) -> str:
        return str(self.args[0])


class GateError(ErrpipeError):
    """Refused by a quality gate (not better than no compensation, outside validity, over a limit)."""

    exit_code = 4


class VerifyError(ErrpipeError):
    """A file is damaged, truncated, foreign, or does not say what its model says."""

    exit_code = 6


# Words of the field -> the word of a recording's columns that means it.
SYNONYMS = {"deviation": "error", "reading": "actual", "target": "command", "dir": "direction", "temp": "temperature"}
SYNONYMS |= {"siemens": "sinumerik"}  # a maker -> how the names of its formats begin
MAX_SUGGESTED = 5  # names with the same beginning; beckhoff has four (by judgement)


def did_you_mean(word: str, allowed: Iterable[str]) -> str:
    """' Did you mean X?' for the nearest allowed word, or '' where none is near."""
    words = list(allowed)
    meant = SYNONYMS.get(word, word)
    if meant in words:
        return f" Did you mean {meant}?"
    begun = [w for w in words if len(word) > 2 and w.startswith(meant)]  # `laser` of laser-iso230
    near = begun if 0 < len(begun) <= MAX_SUGGESTED else difflib.get_close_matches(word, words, n=1, cutoff=0.6)
    return f" Did you mean {' or '.join(near)}?" if near else ""


def first_problem(err: Any, *place: str) -> str:
    """The first problem of pydantic's ValidationError: the keys that lead to it, and what is wrong."""
    first = err.errors()[0]
    return f"{'.'.join(map(str, (*place, *first['loc'])))}: {first['msg']}"
