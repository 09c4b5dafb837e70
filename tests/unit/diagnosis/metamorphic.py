"""Recordings whose answer is known, and what may be done to them without changing it.

A change knows by what powers it scales deviations, temperatures, times and positions, so that the size that
must come back is known too. Written independently of the terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from errpipe.formats import manifest_folder
from trials import folder
from trials.folder import Sheet
from trials.rivals import first_order


@dataclass(frozen=True)
class Known:
    """A recording and its answer. powers: of (deviation, temperature, time, position, force) in the size."""

    sheet: Sheet
    component: str
    effect: str
    size: float
    unit: str
    powers: tuple[int, int, int, int, int]


@dataclass(frozen=True)
class Change:
    """What is done to a recording, and by how much it scales the five quantities."""

    apply: Callable[[Known], Known]
    scales: tuple[float, float, float, float, float] = (1.0, 1.0, 1.0, 1.0, 1.0)
    not_for: tuple[str, ...] = field(default=())  # effects to which the change does not apply


def _sheet(data: dict[str, np.ndarray], specs: dict[str, dict], component: str, unit: str, axis: dict | None) -> Sheet:
    columns = dict(specs)
    columns["deviation"] = {"role": "error", "component": component, "unit": unit}
    columns["model"] = {"role": "simulated", "component": component, "unit": unit}
    return Sheet("known answer", pd.DataFrame(data), columns, "machine", {"X": axis} if axis else {})


def wave() -> Known:
    """A pitch error of 6 um and 25 mm over 500 mm, both directions, four runs, beside a known bow."""
    rng = np.random.default_rng(11)
    places = np.tile(np.r_[np.linspace(3, 497, 90), np.linspace(497, 3, 90)], 3) + rng.uniform(-1.5, 1.5, 540)
    run = np.repeat(["1", "2", "3"], 180)
    bow = 12 * (places / 500) ** 2
    data = {"run": run, "t": 4.0 * np.arange(540), "x": places.round(4), "dir": np.tile(np.repeat([1, -1], 90), 3)}
    data["deviation"] = (bow + 6 * np.sin(2 * np.pi * places / 25 + 0.4) + 0.6 * rng.normal(size=540)).round(5)
    data["model"] = bow.round(5)
    specs = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "dir": {"role": "direction", "axis": "X"},
    }
    axis = {"role": "axis", "kind": "linear", "travel": [0.0, 500.0], "unit": "mm"}
    return Known(_sheet(data, specs, "EXX", "um", axis), "EXX", "pitch_cyclic", 6.0, "um", (1, 0, 0, 0, 0))


def lost_motion() -> Known:
    """Lost motion of 8 um in the runs of `wave`."""
    base = wave()
    rng = np.random.default_rng(12)
    side = base.sheet.values("dir")
    model = base.sheet.values("model")
    table = base.sheet.table.assign(deviation=(model + 4 * side + 0.6 * rng.normal(size=side.size)).round(5))
    return replace(base, sheet=replace(base.sheet, table=table), effect="backlash", size=8.0)


def lag() -> Known:
    """A column that follows a measured temperature 50 minutes late, 3 um/K, a reading every two minutes."""
    rng = np.random.default_rng(13)
    t = 120.0 * np.arange(420)
    levels = np.repeat(rng.uniform(0, 12, 12), 35)
    frame = 21 + first_order(t, levels, 1500.0)
    room = 20 + 1.5 * np.sin(t / 8000)
    late = 3.0 * (first_order(t, frame, 3000.0) - frame[0])
    known = 4.0 * (room - room[0])
    data = {"run": np.repeat(["1", "2", "3"], 140), "t": t, "T_frame": (frame + 0.01 * rng.normal(size=420)).round(4)}
    data["T_room"] = (room + 0.01 * rng.normal(size=420)).round(4)
    data["deviation"] = (known + late + 0.5 * rng.normal(size=420)).round(5)
    data["model"] = known.round(5)
    specs = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "T_frame": {"role": "temperature", "unit": "degC", "location": "frame"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room air"},
    }
    return Known(_sheet(data, specs, "E_Z", "um", None), "E_Z", "thermal_lag", 3.0, "um/K", (1, -1, 0, 0, 0))


def friction() -> Known:
    """Coulomb friction of 25 N missing beside the force that moves the mass."""
    rng = np.random.default_rng(14)
    t = np.arange(1200) / 50
    x = 120 * np.sin(2 * np.pi * t / 6) + 40 * np.sin(2 * np.pi * t / 2.3)
    v, a = np.gradient(x, t), np.gradient(np.gradient(x, t), t)
    model = 0.08 * a
    data = {"t": t, "x": x.round(5), "v": v.round(5), "a": a.round(4)}
    data["deviation"] = (model + 25 * np.sign(v) + 4 * rng.normal(size=t.size)).round(5)
    data["model"] = model.round(5)
    specs = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
        "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
    }
    axis = {"role": "axis", "kind": "linear", "travel": [-170.0, 170.0], "unit": "mm"}
    return Known(_sheet(data, specs, "F_X", "N", axis), "F_X", "coulomb_friction", 25.0, "N", (1, 0, 0, 0, 0))


def push() -> Known:
    """A tool that gives way by 25 um/kN to a cutting force of up to 800 N, beside a drift of the room."""
    rng = np.random.default_rng(15)
    t = 30.0 * np.arange(600)
    room = 20 + 1.5 * np.sin(t / 3000)
    force = np.repeat(rng.uniform(0, 800, 30), 20) * (1 + 0.02 * rng.normal(size=600))
    model = 2 * (room - 20)
    data = {"run": np.repeat(["1", "2", "3"], 200), "t": t, "T_room": room.round(3), "F": force.round(2)}
    data["deviation"] = (model + 25e-3 * force + 0.8 * rng.normal(size=600)).round(5)
    data["model"] = model.round(5)
    specs = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room air"},
        "F": {"role": "force", "axis": "X", "unit": "N"},
    }
    powers = (1, 0, 0, 0, -1)
    return Known(_sheet(data, specs, "E_X", "um", None), "E_X", "cutting_compliance", 25.0, "um/kN", powers)


def wear() -> Known:
    """Five tools, the counter of the length cut runs on: 8 um of wear after 120 m, beside a known swing of the room."""
    rng = np.random.default_rng(16)
    k, cut = np.arange(300), np.cumsum(rng.uniform(1, 3, 300))
    tool = k // 60
    own = cut - np.r_[0.0, cut][tool * 60]
    room = 20 + 1.5 * np.sin(k / 40)
    model = 2 * (room - 20)
    data = {"run": np.array([f"tool {i}" for i in tool]), "t": 40.0 * k, "L": cut.round(3), "T_room": room.round(4)}
    data["deviation"] = (model + 8 * own / 120 + 0.6 * rng.normal(size=300)).round(5)
    data["model"] = model.round(5)
    specs = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "L": {"role": "cut_length", "unit": "m"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room air"},
    }
    longest = max(float(own[tool == i].max()) for i in range(5))
    return Known(_sheet(data, specs, "E_D", "um", None), "E_D", "tool_wear", 8 * longest / 120, "um", (1, 0, 0, 0, 0))


def expansion() -> Known:
    """A scale that grows by 12 um/m/K with its nut's temperature, read at 40 places in both directions."""
    rng = np.random.default_rng(17)
    x = np.tile(np.r_[np.linspace(5, 795, 20), np.linspace(795, 5, 20)], 9)
    t = 15.0 * np.arange(x.size) + 600.0 * (np.arange(x.size) // 120)
    nut = 20 + 8 * (1 - np.exp(-t / 2500)) + 0.4 * np.sin(t / 700)
    side = np.tile(np.repeat([1, -1], 20), 9)
    data = {"run": np.repeat(["1", "2", "3"], 120), "t": t, "x": x.round(4), "dir": side, "T_nut": nut.round(4)}
    data["deviation"] = (3 * side + 12e-3 * x * (nut - 20) + 0.8 * rng.normal(size=x.size)).round(5)
    data["model"] = 3.0 * side
    specs = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "dir": {"role": "direction", "axis": "X"},
        "T_nut": {"role": "temperature", "unit": "degC", "location": "ball-screw nut"},
    }
    axis = {"role": "axis", "kind": "linear", "travel": [0.0, 800.0], "unit": "mm"}
    powers = (1, -1, 0, -1, 0)
    return Known(_sheet(data, specs, "EXX", "um", axis), "EXX", "scale_expansion", 12.0, "um/m/K", powers)


CASES: dict[str, Callable[[], Known]] = {
    "wave": wave,
    "lost motion": lost_motion,
    "lag": lag,
    "friction": friction,
    "push": push,
    "wear": wear,
    "expansion": expansion,
}


# ---------------------------------------------------------------- what may be done to them
WITHOUT_AXIS = ("thermal_lag", "cutting_compliance", "tool_wear")


def _with(known: Known, values: dict[str, np.ndarray], **more) -> Known:
    return replace(known, sheet=replace(known.sheet, table=known.sheet.table.assign(**values), **more))


def _columns(known: Known, *roles: str) -> list[str]:
    return [n for role in roles for n in known.sheet.names(role)]


def _axis_times(known: Known, factor: float) -> dict[str, dict]:
    facts = {}
    for letter, fact in known.sheet.constants.items():
        travel = sorted(float(v * factor) for v in fact["travel"])
        facts[letter] = {**fact, "travel": travel}
    return facts


def positions(factor: float) -> Change:
    """Positions, velocities and accelerations `factor` times as large (a mirrored axis where it is negative)."""

    def apply(known: Known) -> Known:
        names = _columns(known, "position", "velocity", "acceleration")
        values = {n: known.sheet.values(n) * factor for n in names}
        if factor < 0:
            values |= {n: -known.sheet.values(n).astype(int) for n in _columns(known, "direction")}
        return _with(known, values, constants=_axis_times(known, factor))

    return Change(apply, (1, 1, 1, abs(factor), 1), WITHOUT_AXIS)


def times(factor: float) -> Change:
    """The same at another pace."""

    def apply(known: Known) -> Known:
        values = {n: known.sheet.values(n) * factor for n in _columns(known, "time")}
        values |= {n: known.sheet.values(n) / factor for n in _columns(known, "velocity")}
        values |= {n: known.sheet.values(n) / factor**2 for n in _columns(known, "acceleration")}
        return _with(known, values)

    return Change(apply, (1, 1, factor, 1, 1))


def deviations(factor: float) -> Change:
    """Deviations (forces) and their simulation `factor` times as large."""

    def apply(known: Known) -> Known:
        return _with(known, {n: known.sheet.values(n) * factor for n in ("deviation", "model")})

    return Change(apply, (abs(factor), 1, 1, 1, 1))


def temperatures(factor: float) -> Change:
    """Temperatures that vary `factor` times as much about 20 degC."""

    def apply(known: Known) -> Known:
        names = _columns(known, "temperature")
        return _with(known, {n: 20 + (known.sheet.values(n) - 20) * factor for n in names})

    without = ("pitch_cyclic", "backlash", "coulomb_friction", "cutting_compliance", "tool_wear")
    return Change(apply, (1, factor, 1, 1, 1), without)


def forces(factor: float) -> Change:
    """Cutting forces `factor` times as large."""

    def apply(known: Known) -> Known:
        return _with(known, {n: known.sheet.values(n) * factor for n in _columns(known, "force")})

    others = tuple(make().effect for make in CASES.values())
    return Change(apply, (1, 1, 1, 1, factor), tuple(e for e in others if e != "cutting_compliance"))


def _shifted(known: Known) -> Known:
    """Another zero for every clock, place, temperature and deviation."""
    by = {"time": 5e6, "position": 730.0, "temperature": 7.0}
    values = {n: known.sheet.values(n) + by[r] for r in by for n in known.sheet.names(r)}
    values |= {n: known.sheet.values(n) + 50.0 for n in ("deviation", "model")}
    facts = {k: {**f, "travel": [v + 730.0 for v in f["travel"]]} for k, f in known.sheet.constants.items()}
    return _with(known, values, constants=facts)


def _other_axis(known: Known) -> Known:
    """X is called Y."""
    columns = {n: {k: v if k != "axis" else "Y" for k, v in s.items()} for n, s in known.sheet.columns.items()}
    name = known.component.replace("X", "Y")
    for spec in columns.values():
        if "component" in spec:
            spec["component"] = name
    facts = dict(zip("Y", known.sheet.constants.values(), strict=False))
    return replace(known, component=name, sheet=replace(known.sheet, columns=columns, constants=facts))


ROTARY = {"mm": "deg", "mm/s": "deg/s", "mm/s2": "deg/s2", "um": "urad", "N": "N"}


def _rotary_axis(known: Known) -> Known:
    """X is called C and counts degrees: deviations in urad, drive force F_C."""
    columns = {}
    for n, s in known.sheet.columns.items():
        spec = {k: "C" if k == "axis" else v for k, v in s.items()}
        if "component" in spec:
            spec["component"] = known.component.replace("X", "C")
        if "axis" in spec or "component" in spec:
            spec["unit"] = ROTARY.get(spec.get("unit"), spec.get("unit"))
        columns[n] = {k: v for k, v in spec.items() if v is not None}
    facts = {"C": {**known.sheet.constants.get("X", {}), "kind": "rotary", "unit": "deg"}}
    return replace(
        known,
        component=known.component.replace("X", "C"),
        unit=ROTARY.get(known.unit, known.unit),
        sheet=replace(known.sheet, columns=columns, constants=facts),
    )


def _torque(known: Known) -> Known:
    """The drive's torque in N m instead of a force."""
    rotary = _rotary_axis(known)
    columns = {n: {**s, "unit": "N m"} if "component" in s else s for n, s in rotary.sheet.columns.items()}
    return replace(rotary, unit="N m", sheet=replace(rotary.sheet, columns=columns))


def _runs_in(order: Callable[[list], list]) -> Callable[[Known], Known]:
    """The runs stand in the table in another order; their times say which came first."""

    def apply(known: Known) -> Known:
        runs = known.sheet.runs()
        labels = order(list(dict.fromkeys(runs.tolist())))
        table = known.sheet.table.iloc[np.concatenate([np.flatnonzero(runs == r) for r in labels])]
        return replace(known, sheet=replace(known.sheet, table=table.reset_index(drop=True)))

    return apply


# role -> other unit, and what a value is multiplied by and moved by
OTHER_UNITS = {
    "time": ("min", 1 / 60, 0.0),
    "position": ("m", 1e-3, 0.0),
    "velocity": ("m/min", 0.06, 0.0),
    "acceleration": ("m/s2", 1e-3, 0.0),
    "temperature": ("degF", 1.8, 32.0),
    "force": ("kN", 1e-3, 0.0),
    "cut_length": ("km", 1e-3, 0.0),
}


def _other_units(known: Known) -> Known:
    """The same columns in other units; deviations in mm, drive forces in kN."""
    columns, values = {}, {}
    for n, spec in known.sheet.columns.items():
        unit, factor, zero = OTHER_UNITS.get(spec["role"], (spec.get("unit"), 1.0, 0.0))
        if "component" in spec:
            unit, factor = ("mm", 1e-3) if known.unit != "N" else ("kN", 1e-3)
        columns[n] = {**spec, "unit": unit} if "unit" in spec else spec
        values[n] = known.sheet.values(n) * factor + zero if "unit" in spec else known.sheet.table[n]
    return replace(known, sheet=replace(known.sheet, columns=columns, table=known.sheet.table.assign(**values)))


def _columns_renamed(known: Known) -> Known:
    """Columns have other names and stand in the opposite order."""
    names = {n: f"signal_{i}" for i, n in enumerate(reversed(list(known.sheet.columns)))}
    columns = {names[n]: s for n, s in reversed(list(known.sheet.columns.items()))}
    return replace(known, sheet=replace(known.sheet, columns=columns, table=known.sheet.table.rename(columns=names)))


def _thinned(known: Known) -> Known:
    """Every other row."""
    return replace(known, sheet=replace(known.sheet, table=known.sheet.table.iloc[::2].reset_index(drop=True)))


CHANGES: dict[str, Change] = {
    "positions 1e-3": positions(1e-3),
    "positions 1e3": positions(1e3),
    "positions mirrored": positions(-1.0),
    "times 1e-3": times(1e-3),
    "times 1e3": times(1e3),
    "deviations 1e-3": deviations(1e-3),
    "deviations 1e3": deviations(1e3),
    "deviations mirrored": deviations(-1.0),
    "temperatures 1e-3": temperatures(1e-3),
    "temperatures 1e3": temperatures(1e3),
    "forces 1e-3": forces(1e-3),
    "forces 1e3": forces(1e3),
    "shifted": Change(_shifted),
    "axis Y": Change(_other_axis, not_for=("thermal_lag", "tool_wear")),
    "axis C": Change(_rotary_axis, not_for=(*WITHOUT_AXIS, "scale_expansion")),  # a rotary axis has no metres
    "torque in N m": Change(_torque, not_for=tuple(m().effect for m in CASES.values() if m is not friction)),
    "runs reordered": Change(_runs_in(lambda labels: [*labels[1:], labels[0]]), not_for=("coulomb_friction",)),
    "runs backwards": Change(_runs_in(lambda labels: labels[::-1]), not_for=("coulomb_friction",)),
    "other units": Change(_other_units),
    "columns renamed": Change(_columns_renamed),
    "rows thinned": Change(_thinned),
}


def pairs() -> list[tuple[str, str]]:
    """(case, change) of all that belong together."""
    effects = {name: make().effect for name, make in CASES.items()}
    return [(case, change) for case in CASES for change, c in CHANGES.items() if effects[case] not in c.not_for]


def answer(known: Known, where: Path) -> dict:
    """What the diagnosis says of the one response, after a journey through files."""
    from errpipe.diagnosis import diagnose

    folder.write(where, known.sheet)
    document = diagnose(manifest_folder.read(where))[0].document()
    (response,) = document["responses"]
    return response


def expected_size(known: Known, change: Change) -> float:
    """The size that must come back."""
    scale = 1.0
    for factor, power in zip(change.scales, known.powers, strict=True):
        scale *= factor**power
    return known.size * scale
