"""Speeds with missing units: velocities without a unit, spindles that are on or off."""

from __future__ import annotations

import re

import numpy as np

from errpipe.importing.layout import Layout
from errpipe.importing.proposed import Proposal
from errpipe.importing.sheet import label, number
from errpipe.importing.words import kind_by_name, plain

OF_ONE = 1.3  # factor within which a scale matches a unit: noise and delay shift it, units differ by at least 6
FOLLOWS = 0.9  # correlation with the change of the position: below it, it is not a velocity of this axis
# A velocity in each unit for an axis that moves at 1 mm/s (deg/s).
_SCALES = {
    "mm": {"mm/s": 1.0, "m/s": 1e-3, "um/s": 1e3, "mm/min": 60.0, "m/min": 0.06},
    "deg": {"deg/s": 1.0, "rad/s": np.pi / 180.0, "rpm": 1.0 / 6.0, "mdeg/s": 1e3, "deg/min": 60.0},
}
_OF_A_MOTOR = re.compile(r"motor|servo|drive|antrieb", re.IGNORECASE)

_ON = ("on", "ein", "an", "marche", "acceso", "encendido", "running", "run")
_OFF = ("off", "aus", "arret", "spento", "apagado", "stopped", "stop", "standstill")
_SWITCHED = re.compile(r"^(spindle|spindel|broche|mandrino|husillo)( ?(on|state|status|on ?off))?$")
_SPEED = re.compile(r"(\d[\d.,' ]*\d|\d+)\s*(?:rpm|min-1|1/min|u/min|tr/min|r/min)")


def read_switches(layout: Layout) -> None:
    """Convert spindles and coolants written as on and off, in place: to rpm from a line above; to 1 and 0.

    If no line states the spindle's speed, or several do, a note asks for it.
    """
    stated_speeds = {number(m[1], comma=False) for line in layout.above for m in _SPEED.finditer(plain(line))} - {None}
    for c in layout.columns:
        spindle = _SWITCHED.match(plain(c.header)) is not None
        words = set() if c.numeric else {plain(label(x)) for x in c.cells if x not in (None, "")}
        if not words or not words <= {*_ON, *_OFF} or not (spindle or kind_by_name(c.header) == "coolant"):
            continue
        if spindle and len(stated_speeds) != 1:
            layout.notes.append(
                f"{c.header}: on and off, but no line above states one speed: write `Spindle speed: 8000 rpm` there, "
                "or a column of the speed"
            )
            continue
        speed = stated_speeds.copy().pop() if spindle else 1.0
        c.cells = [None if x in (None, "") else (speed if plain(label(x)) in _ON else 0.0) for x in c.cells]
        c.values = np.array([np.nan if x is None else x for x in c.cells])
        c.unit = "rpm" if spindle else c.unit


def units_by_positions(p: Proposal) -> None:
    """Give velocities without a unit that of the position's change; a velocity of another axis is excluded.

    Without a position over time, a velocity keeps the usual unit, but that of a motor, in rpm, is excluded.
    """
    for name in [n for n, e in p.entries.items() if e["role"] == "velocity" and n in p.data]:
        why = p.guesses.get(name, "")
        if "no unit is stated" not in why:
            continue
        found = _scale(p, name)
        if found is None and not _OF_A_MOTOR.search(name):
            continue
        usual = p.entries[name]["unit"]
        if found is None or found[1] is None:
            stated_speeds = f"; {found[0]:.3g} for 1 {usual} of the position" if found else ""
            p.entries[name] = {"role": "ignore"}
            hint = f"declare it with --set {name}.unit=... (mm/s, deg/s, ...)"
            p.guesses[name] = f"a velocity{stated_speeds} without a unit: {hint}"
            continue
        unit = found[1]
        if unit != usual:
            p.data[name] = p.data[name] / _SCALES[usual.split("/")[0]][unit]
        p.guesses[name] = f"{why.partition('; no unit')[0]}; in {unit}, as the position changes"


def _scale(p: Proposal, name: str) -> tuple[float, str | None] | None:
    """Velocity per unit rate of position, and its unit if it matches one; None if it cannot be determined."""
    axis, clock = p.entries[name].get("axis"), p.first("time")
    place = next((n for r in ("command", "actual", "position") if (n := p.first(r, axis)) in p.data), None)
    if place is None or clock not in p.data:
        return None
    t, x, v = p.canonical(clock), p.canonical(place), p.data[name]
    good = np.isfinite(t) & np.isfinite(x) & np.isfinite(v)
    t, x, v = t[good], x[good], v[good]
    if t.size < 20 or np.any(np.diff(t) <= 0):
        return None
    change = np.gradient(x, t)
    if min(np.ptp(change), np.ptp(v)) == 0:
        return None
    follows = float(np.corrcoef(change, v)[0, 1])
    if abs(follows) < FOLLOWS:
        return None
    scale = float(np.sign(follows) * np.std(v) / np.std(change))
    unit = p.entries[name]["unit"].split("/")[0]
    near = [u for u, s in _SCALES[unit].items() if s / OF_ONE < scale < s * OF_ONE]
    return scale, near[0] if near else None
