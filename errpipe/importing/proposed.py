"""A proposed recording: its columns, their manifest entries, and a description of every guess."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from errpipe.domain import units


@dataclass(frozen=True)
class ImportOptions:
    """Command-line options that replace guesses.

    resolution: mm (deg) of one encoder count; torque_constant: N m per A; sets: column -> key -> value.
    """

    axis: str | None = None
    component: str | None = None
    unit: str | None = None
    sign: Literal["actual-minus-commanded", "commanded-minus-actual"] | None = None
    resolution: float | None = None
    torque_constant: float | None = None
    title: str = ""
    machine: str = ""
    sets: dict[str, dict[str, str]] = field(default_factory=dict)


AXIS_ASSUMED = "no axis is named in the file: taken as X (to change it: --axis)"


@dataclass
class Proposal:
    """Rows by column name, the manifest entry of each column, the reason for each guess, and notes on the whole."""

    data: dict[str, Any] = field(default_factory=dict)  # column -> float array (NaN: empty) or list of texts
    entries: dict[str, dict[str, Any]] = field(default_factory=dict)
    guesses: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)  # of the set-up, from the lines above the table
    side: str | None = None  # approach direction of all targets, from a line above the table or its header
    assumed_axis: bool = False  # whether neither the file nor the user named one
    names: dict[str, str] = field(default_factory=dict)  # name of a column in the file -> name here
    headers: set[str] = field(default_factory=set)  # of the file's table

    @property
    def rows(self) -> int:
        """Number of rows."""
        return max((len(v) for v in self.data.values()), default=0)

    def put(self, name: str, values: Any, why: str = "", **entry: Any) -> str:
        """Add a column under an unused name; return that name."""
        base, n = slug(name), 2
        base = entry["role"] if base == "c_" else base
        unique = base
        while unique in self.entries:
            unique, n = f"{base}_{n}", n + 1
        self.names.setdefault(name, unique)
        self.entries[unique] = {k: v for k, v in entry.items() if v is not None}
        if values is not None:
            self.data[unique] = values
        if why:
            self.guesses[unique] = why
        return unique

    def canonical(self, name: str) -> np.ndarray:
        """The values of a column of positions in mm or deg, or of times in s."""
        role = "time" if self.entries[name]["role"] == "time" else "position"
        convert = units.conversion(role, self.entries[name].get("unit"))
        values: np.ndarray = self.data[name] if convert is None else convert(self.data[name])
        return values

    def first(self, role: str, axis: str | None = None) -> str | None:
        """The first column of a role (and axis)."""
        return next((n for n, e in self.entries.items() if e["role"] == role and axis in (None, e.get("axis"))), None)


def slug(text: str) -> str:
    """A header as a plain column name: letters, digits and underscores."""
    for letter, plain in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss"), ("µ", "u"), ("μ", "u"), ("°", "deg")):
        capital = letter.upper() if len(letter.upper()) == 1 else letter  # that of the sharp s is SS, as in words
        text = text.replace(letter, plain).replace(capital, plain.capitalize())
    plain_text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain_text).strip("_")
    return (f"c_{name}" if not name or name[0].isdigit() else name)[:60]
