"""Columns whose numbers are in another unit than the manifest states: named with the evidence, never converted.

A sensor is set aside until its manifest is corrected; where only one of its runs slips, that run is blanked. A
response, a position or a speed that carries such a slip makes the whole recording worthless, and is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.cleaning._base import Action, Rule
from errpipe.domain.recording import Recording
from errpipe.errors import DataError

ROOM = (5.0, 45.0)  # degC: a sensor of a machine at rest reads room temperature, and no machine hall is outside this
NEAR = 6.0  # K: largest spread of the sensors of a machine at the cold start of a run
MIN_SLIP = 20.0  # K: smallest difference that a slip makes to one of them
AIR = {"hPa": (650.0, 1100.0)}  # pressure of the air from sea level to 3500 m
# Of a slip to the right value: what the wrong unit was.
RATIOS = {25.4: "inch", 1 / 25.4: "mm in an inch column", 1000.0: "m", 0.001: "um"}
# Of hPa to what a logger may have written.
PRESSURES = {1000.0: "bar", 0.01: "Pa", 10.0: "kPa", 1.333224: "mmHg", 33.86389: "inHg"}
SPEEDS = {60.0: "per minute and per second mixed", 1 / 60.0: "per minute and per second mixed"}  # of feeds
EXACT = 0.02  # a ratio of two columns of the same quantity within 2 % of such a factor is that factor
MIN_ROWS = 20  # rows


class UnitSlips(Rule):
    """Name columns in degF, K, inch, m or another unit than stated, by comparing them with the other columns."""

    rule: Literal["unit_slips"] = "unit_slips"
    trust: tuple[str, ...] = Field(
        (), description="Columns to exclude from this check (an oil that is really at 68 degC)."
    )

    def find(self, recording: Recording) -> list[Action]:
        """Sensors to set aside. Raises DataError if a position, a speed or a response slips."""
        self._refuse_slipped(recording)
        actions = []
        run, names = recording.run_codes(), recording.names("temperature")
        first = {n: c for n in names if np.isfinite(c := _first_readings(recording.array(n), run)).any()}
        starts = {n: float(np.nanmedian(c)) for n, c in first.items()}
        for name in names:
            if name in self.trust:
                continue
            if evidence := _temperature(recording, name, starts):
                actions.append(Action("set column aside", evidence, column=name))
            else:
                actions += _slipped_runs(recording, name, first)
        for role, judge in (("pressure", _pressure), ("humidity", _humidity)):
            for name in recording.names(role):
                in_air = recording.manifest.columns[name].location is None
                if in_air and name not in self.trust and (evidence := judge(recording.array(name))):
                    actions.append(Action("set column aside", evidence, column=name))
        return actions

    def _refuse_slipped(self, recording: Recording) -> None:
        problems = []
        for role in ("position", "velocity", "error"):
            for name in recording.names(role):
                if name not in self.trust and (evidence := _against_same_quantity(recording, name, role)):
                    problems.append(f"clean, unit_slips: {name}: {evidence}. Mend its unit in the manifest.")
        if problems:
            raise DataError("\n".join(problems))


def _first_readings(values: np.ndarray, run: np.ndarray) -> np.ndarray:
    """First finite reading of each run, shape (runs,); NaN of a run without one. run: codes 0, 1, ..."""
    finite = np.flatnonzero(np.isfinite(values))
    codes, at = np.unique(run[finite], return_index=True)
    first = np.full(run.max() + 1, np.nan)
    first[codes] = values[finite[at]]
    return first


def _slipped_runs(recording: Recording, name: str, first: Mapping[str, np.ndarray]) -> list[Action]:
    """Runs of a temperature in another unit than its other runs: cold by the other sensors, above all that those read.

    first: sensor -> first readings, shape (runs,). A bearing that is hot at the start of a run cools down in it.
    """
    run, values, slipped = recording.run_codes(), recording.array(name), dict[int, str]()
    others = [c for n, c in first.items() if n != name]
    if name not in first or not others:
        return []
    level = np.ma.median(np.ma.masked_invalid(others), axis=0).filled(np.nan)
    for unit, converted in (("degF", (first[name] - 32.0) / 1.8), ("K", first[name] - 273.15)):
        in_hall = (level > ROOM[0]) & (level < ROOM[1])
        for code in np.flatnonzero((first[name] - level > MIN_SLIP) & (abs(converted - level) < NEAR) & in_hall):
            slipped[int(code)] = (
                f"run {recording.run_labels()[code]} starts at {first[name][code]:.4g} where the other sensors start "
                f"at {level[code]:.4g}; taken as {unit} that is {converted[code]:.4g} degC: {unit}, not degC"
            )
    own = np.isin(run, [*slipped])
    elsewhere = values[~own & np.isfinite(values)]
    if not slipped or not elsewhere.size or np.nanmin(values[own]) <= elsewhere.max():
        return []
    reason = f"{'; '.join(slipped.values())} (convert these files, and import them again)"
    return [Action("blank cells", reason, column=name, rows=np.flatnonzero(own))]


def _temperature(recording: Recording, name: str, starts: Mapping[str, float]) -> str:
    """Why a temperature is not in degC, or ''. starts: sensor -> median of the first readings of its runs."""
    values = recording.array(name)
    finite = values[np.isfinite(values)]
    if finite.size < MIN_ROWS:
        return ""
    low, high = np.percentile(finite, [1, 99])
    if ROOM[0] < low - 273.15 and high - 273.15 < 200.0:
        return f"reads {low:.4g} to {high:.4g}: these are kelvin, not degC (write unit: K)"
    others = [n for n in starts if n != name]
    if not others or np.ptp(finite) == 0.0:
        return ""
    room, cold = float(np.median([starts[n] for n in others])), starts[name]
    converted = (cold - 32.0) / 1.8
    if abs(cold - room) > MIN_SLIP and abs(converted - room) < NEAR and ROOM[0] < room < ROOM[1]:
        gain = _gain(values, [recording.array(n) for n in others])
        return (
            f"starts its runs at {cold:.4g} where the other sensors start at {room:.4g}; taken as degF that is"
            f" {converted:.4g} degC{gain}: degF, not degC (write unit: degF)"
        )
    return ""


def _gain(values: np.ndarray, others: list[np.ndarray]) -> str:
    """How much more it moves than the most related other sensor, in words."""
    best, gain = 0.0, 0.0
    for other in others:
        both = np.isfinite(values) & np.isfinite(other)
        if both.sum() >= MIN_ROWS and np.ptp(other[both]) > 0:
            r = abs(float(np.corrcoef(values[both], other[both])[0, 1]))
            if r > best:
                best, gain = r, float(np.std(values[both]) / np.std(other[both]))
    return f", and it moves {gain:.2g} times as much as its nearest relative" if best > 0.9 else ""


def _pressure(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if finite.size == 0 or AIR["hPa"][0] <= np.median(finite) <= AIR["hPa"][1]:
        return ""
    level = float(np.median(finite))
    for factor, unit in PRESSURES.items():
        if AIR["hPa"][0] <= level * factor <= AIR["hPa"][1]:
            return f"reads {level:.5g} hPa, which no air has; as {unit} it is {level * factor:.4g} hPa"
    return ""


def _humidity(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if finite.size >= MIN_ROWS and finite.max() <= 1.0 and finite.max() > 0:
        return f"never exceeds {finite.max():.3g} %: a fraction, not per cent"
    return ""


def _against_same_quantity(recording: Recording, name: str, role: str) -> str:
    """A slip of a column against the one that measures the same quantity, or against the axis' travel."""
    column = recording.manifest.columns[name]
    values = recording.array(name)
    if role == "error":
        twin = recording.name("simulated", component=column.component)
        return "" if twin is None else _ratio(recording.array(twin), values, twin, {1000.0: "mm", 0.001: "nm"})
    if role == "velocity":
        position = recording.name("position", axis=column.axis)
        if position is None or recording.name("time") is None:
            return ""
        same = np.diff(recording.run_codes(), prepend=-1) == 0
        with np.errstate(all="ignore"):
            slope = np.where(
                same,
                np.diff(recording.array(position), prepend=np.nan) / np.diff(recording.time(), prepend=np.nan),
                np.nan,
            )
        return _ratio(slope, values, f"the change of {position} in time", {**RATIOS, **SPEEDS})
    command = recording.name("command", axis=column.axis)
    if command is not None and (ratio := _ratio(recording.array(command), values, command, RATIOS)):
        return ratio
    return _travel(recording, str(column.axis), values)


def _ratio(reference: np.ndarray, values: np.ndarray, what: str, factors: dict[float, str]) -> str:
    """Slope of `reference` over `values`, where it is one of the factors and the two agree otherwise."""
    both = np.isfinite(reference) & np.isfinite(values)
    x, y = values[both], reference[both]
    if x.size < MIN_ROWS or np.ptp(x) == 0 or np.ptp(y) == 0 or abs(np.corrcoef(x, y)[0, 1]) < 0.99:
        return ""
    slope = float(np.std(y) / np.std(x))
    for factor, unit in factors.items():
        if abs(slope / factor - 1) < EXACT:
            return f"{what} is {slope:.4g} times as large (correlation {np.corrcoef(x, y)[0, 1]:.3f}): {unit}"
    return ""


def _travel(recording: Recording, axis: str, values: np.ndarray) -> str:
    facts = recording.manifest.axis(axis)
    finite = values[np.isfinite(values)]
    if facts is None or facts.travel is None or finite.size < MIN_ROWS:
        return ""
    length = facts.travel[1] - facts.travel[0]
    span = float(np.ptp(finite))
    for factor, unit in ((25.4, "inch"), (1000.0, "m")):
        if 0.7 * length <= span * factor <= 1.01 * length:
            taken = f"taken as {unit} it spans {span * factor:.4g}"
            return f"spans {span:.4g} of a travel of {length:g} mm; {taken}: {unit}, not mm"
        if span / factor <= 1.01 * length < span / 5 and span / factor >= 0.7 * length:
            return f"spans {span:.6g} where the travel is {length:g} mm: {factor:g} times too much"
    return ""
