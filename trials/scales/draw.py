"""Draw the cases of the sweep, and write them with their keys."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from trials import folder
from trials.folder import Array
from trials.rivals import accepted, first_order
from trials.seal import seal

from .axes import drive_force, positioning, under_way
from .bench import Bench, Effect, Rng, log_uniform
from .bodies import cutting, grid, warm_body

BENCHES: dict[str, Callable[[Rng], Bench]] = {
    "positioning": positioning,
    "axis log": under_way,
    "drive force": drive_force,
    "warm body": warm_body,
    "grid": grid,
    "cutting series": cutting,
}
# What is hidden how often: the first five carry 60 % of the sweep.
CORE = (
    ("wave", (("positioning", "pitch_cyclic"), ("axis log", "pitch_cyclic"), ("drive force", "torque_ripple"))),
    ("lost motion", (("positioning", "backlash"), ("axis log", "backlash"))),
    ("wear", (("positioning", "local_wear"), ("axis log", "local_wear"), ("cutting series", "tool_wear"))),
    ("thermal drift", (("positioning", "thermal_drift"), ("warm body", "thermal_drift"))),
    ("lag", (("warm body", "thermal_lag"), ("warm body", "thermal_lag"))),
)
FURTHER = (
    ("positioning", "scale_error"),
    ("positioning", "scale_expansion"),
    ("positioning", "screw_windup"),
    ("axis log", "following_error"),
    ("axis log", "inertial_deflection"),
    ("axis log", "friction_hysteresis"),
    ("drive force", "coulomb_friction"),
    ("drive force", "viscous_friction"),
    ("drive force", "stribeck_friction"),
    ("warm body", "gradient_bending"),
    ("warm body", "spindle_growth"),
    ("warm body", "ambient_drift"),
    ("warm body", "sensor_drift"),
    ("warm body", "centrifugal_growth"),
    ("grid", "squareness"),
    ("grid", "straightness"),
    ("grid", "angular_abbe"),
    ("grid", "workpiece_load"),
    ("cutting series", "cutting_compliance"),
    ("cutting series", "thermal_drift"),
)
CORE_SHARE = 0.6
NAMED = 3  # the cases that the issue names come first


def plan(rng: Rng, cases: int) -> list[tuple[str, str]]:
    """(bench, effect) of every case but the named ones; every effect takes its turn."""
    core: list[tuple[str, str]] = []
    further: list[tuple[str, str]] = []
    out = []
    for k in range(cases):
        if rng.random() < CORE_SHARE:
            if not core:
                core = [places[int(rng.integers(len(places)))] for _, places in CORE]
                rng.shuffle(core)
            out.append(tuple(core.pop()))
        else:
            if not further:
                further = list(FURTHER)
                rng.shuffle(further)
            out.append(tuple(further.pop()))
        del k
    return out


def named_case(rng: Rng, number: int) -> tuple[Bench, list[str]]:
    """A sine of 20 um over 28 periods of 0.4 mm; lost motion and a lag in a 1 kHz log; a worm-driven rotary axis."""
    if number == 0:
        bench = positioning(rng, 1)
        (p,) = bench.sheet.names("position")
        x = bench.sheet.values(p)
        wave = 20 * np.sin(2 * np.pi * (x - x.min()) / 0.4)
        sizes = {"amplitude": (20.0, "um", True), "period": (0.4, "mm", False)}
        return replace(bench, effects={"pitch_cyclic": Effect(wave, (p,), sizes, ("interpolation",))}), ["pitch_cyclic"]
    if number == 1:
        bench = under_way(rng, 3, 1000.0, 100.0)
        t, warm = bench.sheet.values("t"), bench.sheet.values("T_motor")
        lag = first_order(t, warm - warm[0], 40.0)
        gain = 8 / np.ptp(lag)
        late = Effect(gain * lag, ("T_motor",), {"gain": (gain, "um/K", True), "tau": (40.0, "s", False)})
        lost = Effect(4 * np.sign(bench.sheet.values("v")), ("v",), {"lost_motion": (8.0, "um", True)})
        return replace(bench, effects={"backlash": lost, "thermal_lag": late}), ["backlash", "thermal_lag"]
    bench = positioning(rng, 9)
    (p,) = bench.sheet.names("position")
    x = bench.sheet.values(p)
    wave = 25 * np.sin(2 * np.pi * x / 12.0 + 1) + 6 * np.sin(4 * np.pi * x / 12.0)  # a worm of 30 : 1
    sizes = {"amplitude": (25.0, "urad", True), "period": (12.0, "deg", False)}
    return replace(bench, effects={"pitch_cyclic": Effect(wave, (p,), sizes, ("interpolation",))}), ["pitch_cyclic"]


def compose(rng: Rng, bench: Bench, hidden: list[str], natural: bool) -> tuple[folder.Sheet, dict]:
    """The recording with its response, and the key of that response. natural: sizes as the effect states them."""
    parts = [bench.effects[name] for name in hidden]
    scale = 1.0 if natural else log_uniform(rng, 0.5, 2.0)
    acts = sum(p.values for p in parts) * scale
    size = float(np.std(acts))
    noise = size / log_uniform(rng, 3, 30)
    gains = 1 + rng.uniform(-0.04, 0.04, len(bench.base)) * (rng.random() < 0.4)
    shares = [size * log_uniform(rng, 0.3, 4) for _ in bench.base]
    included = [s * b for s, b in zip(shares, bench.base, strict=True)]
    truth = sum(included) + acts
    simulated = sum(g * b for g, b in zip(gains, included, strict=True))
    step = folder.nice_step(noise * rng.uniform(0.1, 0.6))
    recorded = folder.rounded(truth + noise * rng.normal(size=truth.size), step)
    sheet = bench.sheet
    c = bench.component
    table = sheet.table.assign(**{c: recorded, f"{c}_sim": folder.rounded(simulated, step / 100)})
    columns = dict(sheet.columns)
    columns[c] = {"role": "error", "component": c, "unit": bench.unit}
    columns[f"{c}_sim"] = {"role": "simulated", "component": c, "unit": bench.unit}
    key = {"verdict": ["missing_physics"], "effects": [], "truth": [], "drivers": {}, "params": {}, "where": None}
    for name, part in zip(hidden, parts, strict=True):
        names, drivers = accepted(sheet, c, name, scale * part.values, bench.base, noise)
        key["effects"].append([*names, *(a for a in part.also if a not in names)])
        key["truth"].append(f"{name}: {bench.scale}")
        key["drivers"] |= {**drivers, name: sorted({*part.drivers, *drivers.get(name, [])})}
        for what, (value, unit, grows) in part.sizes.items():
            key["params"][f"{name}.{what}"] = {"value": abs(value) * (scale if grows else 1), "unit": unit}
    key |= {"noise_rms": float(np.hypot(noise, step / np.sqrt(12))), "unit": bench.unit}
    key |= {"before_rms": float(np.sqrt(np.mean((recorded - simulated) ** 2)))}
    return replace(sheet, table=table, columns=columns), {"component": c, "response": key}


def fair_base(bench: Bench, hidden: list[str]) -> list[Array]:
    """What the simulation may hold: contributions that together play at most half of any hidden effect."""
    kept: list[Array] = []
    for b in bench.base:
        if all(unplayed(bench.effects[name].values, [*kept, b]) > 0.5 for name in hidden):
            kept.append(b)
    return kept


def unplayed(values: Array, base: list[Array]) -> float:
    """Share of the sum of squares of `values`, without its mean, that other gains on `base` cannot play."""
    y = values - values.mean()
    x = np.column_stack([b - b.mean() for b in base])
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return float(left @ left) / max(float(y @ y), 1e-300)


def one_case(seed: int, number: int, bench_name: str, effect: str) -> tuple[folder.Sheet, dict]:
    """Draw until fair; the same for the same (seed, number)."""
    for attempt in range(60):
        rng = np.random.default_rng([seed, number, attempt, 5])
        if number < NAMED:
            bench, hidden = named_case(rng, number)
        else:
            bench, hidden = BENCHES[bench_name](rng), [effect]
        base = fair_base(bench, hidden) if all(name in bench.effects for name in hidden) else []
        if base:
            bench = replace(bench, base=base)
            sheet, key = compose(rng, bench, hidden, natural=number < NAMED)
            tier = "pair" if len(hidden) > 1 else "plain"
            name = "named" if number < NAMED else bench_name
            return sheet, {"tier": tier, "protocol": name, "responses": {key["component"]: key["response"]}}
    raise RuntimeError(f"case {number}: no fair {effect} on a {bench_name} in 60 draws")


def generate(out: Path, seed: int, cases: int, only: str | None = None) -> None:
    """out/cases/<id>/, out/answers/<id>.json and out/answers.sha256."""
    keys = {}
    for number, (bench, effect) in enumerate(plan(np.random.default_rng([seed, 77]), cases)):
        if only and effect not in only.split(",") and number >= NAMED:
            continue
        sheet, key = one_case(seed, number, bench, effect)
        name = hashlib.sha256(f"scales {seed} {number}".encode()).hexdigest()[:10]
        folder.write(out / "cases" / name, sheet)
        keys[name] = {"case": name, **key}
    seal(out, keys)


def read_keys(out: Path) -> dict[str, dict]:
    return {p.stem: json.loads(p.read_text()) for p in sorted((out / "answers").glob("*.json"))}


def mismatch_rms(sheet: folder.Sheet, component: str) -> float:
    """Rms of recorded minus simulated, without its mean."""
    error, twin = sheet.responses()[component]
    gap: Array = sheet.values(error) - sheet.values(str(twin))
    return float(np.nanstd(gap))
