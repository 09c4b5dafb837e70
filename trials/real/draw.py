"""Nulls and additions from twins: nothing is missing, or one known effect is, at a size that the noise allows."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from trials import folder
from trials.folder import Array, Sheet
from trials.rivals import accepted, first_order, possible
from trials.seal import seal

from .repetitions import Twin, twins, window

Rng = np.random.Generator
# effect, what it adds per row, columns that drive it, size parameters: name -> (value per unit of addition, unit)
Addition = tuple[str, Array, tuple[str, ...], dict[str, tuple[float, str]]]
SIZES = (3.0, 8.0)  # rms of an addition, in rms of what the repetition itself leaves
UNPLAYED = 0.5  # share of an addition that no gain on the simulation can play
LEAST_PLACES = 25  # distinct places that a wave or a bump needs


def additions(rng: Rng, twin: Twin) -> list[Addition]:
    """The textbook effects that the columns of a twin allow on its component."""
    sheet, component = twin.sheet, twin.component
    unit = sheet.columns[component]["unit"]
    out = [*_on_places(rng, sheet, unit), *_on_motion(sheet, unit), *_on_temperatures(rng, sheet, unit)]
    out += _on_use(sheet, unit)
    simulated = sheet.values(f"{component}_sim")
    return [
        a
        for a in out
        if possible(a[0], component, sheet.columns[a[2][0]].get("axis"))
        and np.all(np.isfinite(a[1]))
        and np.std(a[1]) > 0
        and _unplayed(a[1], simulated) > UNPLAYED
    ]


def _unplayed(values: Array, simulated: Array) -> float:
    y, s = values - values.mean(), simulated - simulated.mean()
    return 1.0 - float((y @ s) ** 2 / max((y @ y) * (s @ s), 1e-300))


def _on_places(rng: Rng, sheet: Sheet, unit: str) -> Iterator[Addition]:
    force = unit in FORCES
    for p in sheet.names("position"):
        x = sheet.values(p)
        span, where = float(np.ptp(x)), sheet.columns[p]["unit"]
        per = {"mm": (1e3, f"{unit}/m")}.get(where, (1.0, f"{unit}/{where}"))
        places = np.unique(np.round(x / max(span, 1e-12), 4)).size
        u = (x - x.min()) / max(span, 1e-12)
        if places >= LEAST_PLACES:
            period = span / rng.uniform(2.5, min(places / 6, 25))
            wave = np.sin(2 * np.pi * x / period + rng.uniform(0, 6))
            sizes = {"amplitude": (1.0, unit), "period": (0.0, where)}
            yield "torque_ripple" if force else "pitch_cyclic", wave, (p,), {**sizes, "period": (period, where)}
            bump = np.exp(-0.5 * ((u - rng.uniform(0.25, 0.75)) / rng.uniform(0.05, 0.1)) ** 2)
            if not force:
                yield "local_wear", bump, (p,), {"depth": (1.0, unit)}
        if not force:
            yield "scale_error", x - x.mean(), (p,), {"slope": per}
            yield "squareness", x - x.mean(), (p,), {"angle": (1e3, "urad")}
            if places >= 9:
                yield "straightness", 4 * u * (1 - u), (p,), {"bow": (1.0, unit)}
        for d in sheet.names("direction"):
            side = sheet.values(d)
            sizes = {"force": (1.0, unit)} if force else {"lost_motion": (2.0, unit)}
            yield "coulomb_friction" if force else "backlash", side, (d,), sizes


def _on_motion(sheet: Sheet, unit: str) -> Iterator[Addition]:
    for name in sheet.names("velocity"):
        v = sheet.values(name)
        fast = float(np.quantile(np.abs(v), 0.99))
        if unit in FORCES:
            yield "coulomb_friction", np.sign(v), (name,), {"force": (1.0, unit)}
            linear = sheet.columns[name]["unit"] == "mm/s"
            yield "viscous_friction", v, (name,), {"slope": (1e3, "N s/m")} if linear else {}
            knee = 0.08 * fast
            yield "stribeck_friction", np.sign(v) * np.exp(-((v / knee) ** 2)), (name,), {"excess": (1.0, unit)}
        else:
            yield "backlash", np.sign(v), (name,), {"lost_motion": (2.0, unit)}
            yield "following_error", v, (name,), {"delay": (1e-3, "s")}


def _on_temperatures(rng: Rng, sheet: Sheet, unit: str) -> Iterator[Addition]:
    sensors, times = sheet.names("temperature"), sheet.names("time")
    if not sensors or not times or unit in FORCES:
        return
    t, runs = sheet.values(times[0]), sheet.runs()
    s, other = (str(n) for n in rng.choice(sensors, 2, replace=len(sensors) < 2))
    for name in (s, other):
        u = sheet.values(name)
        yield "thermal_drift", u - u[0], (name,), {"gain": (1.0, f"{unit}/K")}
    if s != other:
        yield "gradient_bending", sheet.values(s) - sheet.values(other), (s, other), {"gain": (1.0, f"{unit}/K")}
    length = np.median([np.ptp(t[runs == r]) for r in np.unique(runs)])
    step = np.median(np.diff(t)[np.diff(t) > 0])
    tau = float(np.exp(rng.uniform(np.log(6 * step), np.log(max(length / 4, 7 * step)))))
    late = np.concatenate([first_order(t[runs == r], sheet.values(s)[runs == r], tau) for r in _in_order(runs)])
    yield "thermal_lag", late - late[0], (s,), {"gain": (1.0, f"{unit}/K"), "tau": (tau, "s")}


def _in_order(runs: Array) -> list[str]:
    return list(dict.fromkeys(runs.tolist()))


def _on_use(sheet: Sheet, unit: str) -> Iterator[Addition]:
    for name in sheet.names("cut_length"):
        yield "tool_wear", sheet.values(name), (name,), {"rate": (1.0, f"{unit}/m")}
    for name in sheet.names("time") if not sheet.names("cut_length") else ():
        t, runs = sheet.values(name), sheet.runs()
        if not np.any(np.diff(t) < 0) and np.unique(runs).size < 4:
            yield "sensor_drift", t - t[0], (name,), {"rate": (3600.0, f"{unit}/h")}


FORCES = ("N", "N m")
FIXED = ("period", "tau")  # parameters that do not grow with the addition


def add(rng: Rng, twin: Twin, addition: Addition) -> tuple[Sheet, dict]:
    """The twin with one effect added to what was recorded, and the key of its response."""
    effect, values, drivers, sizes = addition
    sheet, c = twin.sheet, twin.component
    noise = float(np.std(twin.gap()))
    factor = noise * rng.uniform(*SIZES) / float(np.std(values)) * rng.choice([-1, 1])
    digits = int(np.clip(np.ceil(-np.log10(noise)) + 3, 0, 12))
    table = sheet.table.assign(**{c: np.round(sheet.values(c) + factor * values, digits)})
    names, known = accepted(sheet, c, effect, values)
    params = {
        f"{effect}.{n}": {"value": v if n in FIXED else abs(factor) * v, "unit": u} for n, (v, u) in sizes.items()
    }
    key = {"verdict": ["missing_physics"], "effects": [names], "truth": [f"{effect}: {twin.source}, {twin.kind}"]}
    key |= {"drivers": {**known, effect: sorted({*drivers, *known.get(effect, [])})}, "params": params, "where": None}
    return replace(sheet, table=table), {**key, "noise_rms": noise}


def null(twin: Twin) -> tuple[Sheet, dict]:
    """The twin as it is: nothing is missing; gain and datum of a repetition may differ, its scatter sees to that."""
    key = {"verdict": ["no_mismatch", "recalibrate"], "effects": [], "truth": [], "drivers": {}, "params": {}}
    return twin.sheet, {**key, "where": None, "noise_rms": float(np.std(twin.gap()))}


def by_turns(rng: Rng, pool: list[Twin]) -> Iterator[Twin]:
    """Twins without end: every source in turn, in random order; then a random twin of it, and a window of that."""
    sources = sorted({t.source for t in pool})
    while True:
        for source in rng.permutation(sources):
            own = [t for t in pool if t.source == source]
            yield window(rng, own[int(rng.integers(len(own)))])


def generate(out: Path, sheets: list[tuple[str, Sheet]], seed: int, nulls: int, added: int) -> dict[str, int]:
    """out/cases/<id>/, out/answers/, sealed. Returns the number of twins by source and kind.

    Raises ValueError where no recording has a repetition.
    """
    rng = np.random.default_rng([seed, 1234])
    pool = [t for name, sheet in sheets for t in twins(name, sheet)]
    if not pool:
        raise ValueError("none of these recordings has a repetition: no period, no run over the same places, no log")
    keys = {}
    turns = by_turns(rng, pool)
    for number in range(nulls + added):
        sheet, key, twin, tier = _case(rng, turns, number < nulls)
        name = hashlib.sha256(f"real {seed} {number}".encode()).hexdigest()[:10]
        folder.write(out / "cases" / name, sheet)
        protocol = f"{twin.source}, {twin.kind}"
        keys[name] = {"case": name, "tier": tier, "protocol": protocol, "responses": {twin.component: key}}
    seal(out, keys)
    kinds = [f"{t.source}, {t.kind}" for t in pool]
    return {k: kinds.count(k) for k in dict.fromkeys(kinds)}


def _case(rng: Rng, turns: Iterator[Twin], is_null: bool) -> tuple[Sheet, dict, Twin, str]:
    for twin in turns:
        if is_null:
            return *null(twin), twin, "null"
        possible_here = additions(rng, twin)
        if possible_here:
            chosen = possible_here[int(rng.integers(len(possible_here)))]
            return *add(rng, twin, chosen), twin, "plain"
    raise AssertionError("turns do not end")
