"""Hide something (or nothing) from the simulation, size it, measure it, and write the key."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import chain
from .case import Array, Bench, Contribution, Response
from .lookalikes import compare, sharpened

TIERS = ("plain", "concealed", "pair", "partial", "null", "novel")
ORACLE = 1.15
# Included physics that resembles the hidden effect: what makes a concealed case hard.
RESEMBLES = {
    "scale_error": ("scale_expansion", "feed_heating", "screw_windup", "squareness"),
    "pitch_cyclic": ("scale_error", "interpolation", "straightness", "torque_ripple"),
    "interpolation": ("pitch_cyclic",),
    "local_wear": ("pitch_cyclic", "straightness", "scale_error"),
    "straightness": ("squareness", "angular_abbe", "gravity_sag"),
    "squareness": ("straightness", "scale_error", "angular_abbe"),
    "angular_abbe": ("squareness", "straightness", "gravity_sag"),
    "gravity_sag": ("straightness", "squareness", "workpiece_load", "angular_abbe"),
    "workpiece_load": ("gravity_sag", "angular_abbe"),
    "backlash": ("screw_windup", "friction_hysteresis", "reversal_spike"),
    "screw_windup": ("backlash", "scale_error"),
    "friction_hysteresis": ("screw_windup", "reversal_spike"),
    "reversal_spike": ("backlash", "friction_hysteresis"),
    "following_error": ("inertial_deflection", "backlash"),
    "inertial_deflection": ("following_error", "servo_mismatch"),
    "servo_mismatch": ("squareness", "inertial_deflection"),
    "coulomb_friction": ("viscous_friction", "moving_mass"),
    "viscous_friction": ("coulomb_friction", "stribeck_friction"),
    "stribeck_friction": ("coulomb_friction", "viscous_friction"),
    "torque_ripple": ("moving_mass", "coulomb_friction"),
    "scale_expansion": ("scale_error", "feed_heating", "air_refraction"),
    "thermal_drift": ("ambient_drift", "spindle_growth", "thermal_lag"),
    "thermal_lag": ("thermal_drift", "spindle_growth", "feed_heating", "ambient_drift"),
    "thermal_interaction": ("thermal_drift", "thermal_lag"),
    "gradient_bending": ("thermal_drift", "ambient_drift"),
    "spindle_growth": ("thermal_drift", "centrifugal_growth", "ambient_drift"),
    "feed_heating": ("scale_expansion", "scale_error"),
    "ambient_drift": ("thermal_drift", "thermal_lag", "spindle_growth"),
    "coolant_effect": ("thermal_drift", "ambient_drift", "spindle_growth"),
    "centrifugal_growth": ("spindle_growth", "thermal_drift"),
    "cutting_compliance": ("tool_wear", "spindle_growth"),
    "tool_wear": ("cutting_compliance", "ambient_drift", "thermal_drift"),
    "air_refraction": ("scale_expansion", "scale_error"),
    "sensor_drift": ("ambient_drift", "thermal_lag", "thermal_drift"),
}


USUAL_NOISE = {  # rms, um (N for forces); what the public sample shows
    "linear positioning": (0.4, 1.5),
    "spindle drift": (0.2, 2.3),
    "circular test": (0.2, 1.0),
    "feedback trace": (0.3, 1.0),
    "N": (1.5, 5.0),
    "volumetric grid": (0.35, 4.0),
    "cutting series": (0.6, 1.6),
}
NO_FORM = {"reversal_spike", "clock_offset", "sensor_fault", "torque_ripple", "friction_hysteresis"}
MOSTLY_EXPLAINED = 0.85  # a novel mechanism that one textbook form explains so far is not novel
LEAST_OWN = 0.75  # share of a hidden contribution that its own textbook form must explain
STEPS = {  # of the display, um or N
    "linear positioning": (0.01, 0.02, 0.04, 0.1, 0.1),
    "spindle drift": (0.02, 0.03, 0.05, 0.1),
    "circular test": (0.01, 0.01, 0.05),
    "feedback trace": (0.01, 0.01, 0.05),
    "N": (0.1, 0.2, 0.5),
    "volumetric grid": (0.1, 0.1, 0.05),
    "cutting series": (0.1, 0.5, 0.5),
}
# Effects that may act on one stretch of the axis only.
STRETCH = {
    "backlash",
    "pitch_cyclic",
    "interpolation",
    "friction_hysteresis",
    "screw_windup",
    "coulomb_friction",
    "viscous_friction",
    "torque_ripple",
    "straightness",
}


class Unfit(Exception):
    """A draw that would not make a fair case: draw again."""


@dataclass
class Story:
    """One response: what the machine does, what the simulation says, what is hidden."""

    response: Response
    included: list[Contribution]
    gains: list[float]
    datum: float
    hidden: list[Contribution]
    noise: float
    truth: Array = field(default_factory=lambda: np.zeros(0))
    simulated: Array = field(default_factory=lambda: np.zeros(0))
    error: Array = field(default_factory=lambda: np.zeros(0))
    clean: Array = field(default_factory=lambda: np.zeros(0))
    step: float = 0.01

    @property
    def exact(self) -> bool:
        return self.datum == 0 and all(g == 1.0 for g in self.gains)


def wrong_gains(rng: np.random.Generator, n: int, least: float = 0.02) -> list[float]:
    """0 to 15 % off: one common factor, or each its own."""
    if rng.random() < 0.35:
        return [round(float(1 + rng.choice([-1, 1]) * rng.uniform(max(least, 0.03), 0.15)), 4)] * n
    off = np.clip(rng.uniform(least, 0.19, n), 0, 0.15) * rng.choice([-1, 1], n)
    return [round(float(1 + d), 4) for d in off]


def choose(
    rng: np.random.Generator, response: Response, without: set[str], near: tuple[str, ...] = ()
) -> list[Contribution]:
    """Two to four effects that the simulation knows, those `near` first."""
    names = [n for n in response.effects if n not in without and n not in ("sensor_fault", "clock_offset")]
    rng.shuffle(names)
    close = [n for n in names if n in near][:2]
    rest = [n for n in names if n not in close]
    if "moving_mass" in names:  # every simulation of a drive holds it
        close = ["moving_mass", *[n for n in close if n != "moving_mass"]]
        rest = [n for n in rest if n != "moving_mass"]
    n = min(int(rng.integers(2, 5)), len(names))
    return [response.effects[k] for k in (close + rest)[: max(n, len(close))]]


def off_by(included: list[Contribution], gains: list[float], n: int) -> Array:
    total = np.zeros(n)
    for c, g in zip(included, gains, strict=True):
        total += (1 - g) * c.values
    return total


def _rms(values: Array) -> float:
    return float(np.std(values)) if values.size else 0.0


def ratio(rng: np.random.Generator, faint: float = 0.6) -> float:
    """How many times the noise the hidden effect is: 2 to 5, the faint ones at the low end."""
    return float(rng.uniform(2.0, 2.7) if rng.random() < faint else 2.0 + 3.0 * rng.beta(1.1, 1.5))


def quiet(rng: np.random.Generator, bench: Bench, response: Response, kind: str | None = None) -> Story:
    """A response from which nothing is missing: exact, wrongly scaled, or shifted."""
    rows = bench.measured
    kind = kind or str(rng.choice(["exact", "gains", "datum"], p=[0.42, 0.46, 0.12]))
    included = choose(rng, response, set())
    size = _rms(sum(c.values for c in included)[rows])
    if size <= 0:
        raise Unfit("nothing included")
    low, high = usual_noise(bench, response)
    noise = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    count = len(included)
    if kind == "exact":
        noise = float(np.clip(noise, 0.02 * size, 0.3 * size))
        return Story(response, included, [1.0] * count, 0.0, [], noise)
    if kind == "datum":
        noise = float(np.clip(noise, 0.02 * size, 0.3 * size))
        datum = float(noise * rng.uniform(0.6, 5) * rng.choice([-1, 1]))
        return Story(response, included, [1.0] * count, datum, [], noise)
    gains = wrong_gains(rng, count, 0.04)
    rest = _rms(off_by(included, gains, bench.rows)[rows])
    noise = float(np.clip(noise, rest / 5.5, rest / rng.uniform(0.7, 1.6)))
    datum = float(noise * rng.uniform(-3, 3)) if rng.random() < 0.5 else 0.0
    return Story(response, included, gains, datum, [], noise)


def hide(rng: np.random.Generator, bench: Bench, response: Response, tier: str, wanted: str | None) -> Story:
    """A response from which something is missing."""
    rows, n = bench.measured, bench.rows
    hidden = _drawn(rng, bench, response, tier, wanted)
    names = {c.effect for c in hidden}
    near = (
        tuple(x for c in hidden for x in RESEMBLES.get(c.effect, ()))
        if tier in ("concealed", "pair") or rng.random() < 0.3
        else ()
    )
    late = any(c.effect == "clock_offset" for c in hidden)
    if tier == "concealed":
        if late or hidden[0].carrier is not None:
            raise Unfit("cannot be scaled")
    else:
        hidden, least = _sized(rng, bench, response, hidden)
    carriers = [c.carrier for c in hidden if c.carrier is not None]
    included = _late(hidden, response) if late else choose(rng, response, names | {c.effect for c in carriers}, near)
    everything = [*included[:2], *carriers] if carriers else included
    gains = wrong_gains(rng, len(everything), 0.08 if tier == "concealed" else 0.02)
    rest = _rms(off_by(everything, gains, n)[rows])
    low, high = usual_noise(bench, response)
    if tier == "concealed":
        hidden, noise = _concealed(rng, hidden[0], rest, rows, 0.5 * low)
    else:
        if rest > least:  # what wrong gains cause must stay below the hidden effect
            smaller = max(least / rest * rng.uniform(0.4, 1.0), 0.4)
            everything = [c if c in carriers or late else c.scaled(smaller) for c in everything]
            rest = _rms(off_by(everything, gains, n)[rows])
            if rest > least:
                gains = [round(1 + (g - 1) * least / rest * 0.9, 4) for g in gains]
        noise = least / (ratio(rng) if len(hidden) == 1 else rng.uniform(1.5, 4.5))
        if not 0.25 * low < noise < 2.5 * high:
            raise Unfit("an unusual noise")
    datum = float(noise * rng.uniform(-4, 4)) if rng.random() < 0.5 else 0.0
    return Story(response, everything, gains, datum, hidden, float(noise))


def usual_noise(bench: Bench, response: Response) -> tuple[float, float]:
    """Lowest and highest usual noise of a response."""
    low, high = USUAL_NOISE["N" if response.unit == "N" else bench.protocol]
    return (0.3 * low, 0.3 * high) if response.component == "E_X" and bench.protocol == "spindle drift" else (low, high)


def _concealed(
    rng: np.random.Generator, one: Contribution, rest: float, rows: Array, least_noise: float
) -> tuple[list[Contribution], float]:
    """Half as large to as large as the rest of the mismatch."""
    size = one.rms(rows)
    if size <= 0 or rest <= 0:
        raise Unfit("nothing to conceal behind")
    want = rest * rng.uniform(0.5, 1.0)
    if want > 2.5 * size:
        raise Unfit("cannot be scaled")
    noise = max(want / rng.uniform(0.7, 2.4), least_noise)
    if noise > 1.5 * want:
        raise Unfit("lost in the noise")
    return [one.scaled(want / size)], noise


def _sized(
    rng: np.random.Generator, bench: Bench, response: Response, hidden: list[Contribution]
) -> tuple[list[Contribution], float]:
    """Hidden effects near a size that suits the usual noise of the protocol, and the smaller one's rms."""
    sizes = [c.rms(bench.measured) for c in hidden]
    if min(sizes) <= 0:
        raise Unfit("the effect does not act")
    low, high = usual_noise(bench, response)
    target = 3.0 * np.exp(rng.uniform(np.log(low), np.log(high)))
    out = []
    for c, size in zip(hidden, sizes, strict=True):
        wanted = float(np.clip(target * rng.uniform(0.7, 1.5) / size, 0.2, 1.4))
        fixed = c.effect in ("clock_offset", "air_refraction", "feed_heating")
        out.append(c if fixed else c.scaled(wanted))
    return out, min(c.rms(bench.measured) for c in out)


def _late(hidden: list[Contribution], response: Response) -> list[Contribution]:
    parts = hidden[0].display[1] if hidden[0].display else None
    if parts is None:
        raise Unfit("clock offset without its parts")
    hidden[0].display = None
    return [response.effects[k] for k in parts]


def _drawn(rng, bench: Bench, response: Response, tier: str, wanted: str | None) -> list[Contribution]:
    if tier == "novel":
        names = list(response.novel)
        if not names:
            raise Unfit("no mechanism outside the vocabulary here")
        return [response.novel[str(rng.choice(names))]]
    names = list(response.hideable or response.effects)
    first = wanted if wanted in names else str(rng.choice(names))
    one = response.effects[first]
    if tier == "pair":
        others = [n for n in names if n not in (first, "clock_offset", "sensor_fault", "local_wear", "reversal_spike")]
        if first in ("clock_offset", "sensor_fault") or not others:
            raise Unfit("not in pairs")
        return [one, response.effects[str(rng.choice(others))]]
    return [_partly(rng, bench, one)] if tier == "partial" else [one]


def _partly(rng, bench: Bench, one: Contribution) -> Contribution:
    """The effect acts only in some runs, for some time, or on one stretch."""
    if one.active is not None or one.effect in ("clock_offset", "sensor_fault", "sensor_drift"):
        raise Unfit("already local")
    runs = np.array(bench.run)
    labels = [r for r in dict.fromkeys(bench.run) if bench.measured[runs == r].any()]
    options = ["runs", "runs"] if len(labels) > 1 else ["time"]
    if one.effect in STRETCH and bench.protocol != "circular test":
        options.append("stretch")
    kind = str(rng.choice(options))
    if kind == "runs":
        some = int(rng.integers(max(1, len(labels) // 5), max(2, len(labels) // 2 + 1)))
        start = int(rng.integers(0, len(labels) - some + 1))
        chosen = (
            labels[start : start + some]
            if rng.random() < 0.7
            else sorted(rng.choice(labels, some, replace=False).tolist(), key=labels.index)
        )
        mask, where = np.isin(runs, chosen), {"runs": [str(c) for c in chosen]}
    else:
        column = "t" if kind == "time" else next(n for n, c in bench.columns.items() if c.spec["role"] == "position")
        v = bench.columns[column].values
        width = rng.uniform(0.25, 0.5) * np.ptp(v)
        lo = v.min() + rng.uniform(0.05, 0.95) * (np.ptp(v) - width)
        mask = (v >= lo) & (v <= lo + width)
        where = (
            {"ranges": {column: [round(float(v[mask].min()), 3), round(float(v[mask].max()), 3)]}} if mask.any() else {}
        )
    part = mask & bench.measured
    if part.sum() < 20:
        raise Unfit("too little of it")
    values = np.where(mask, one.values, 0.0)
    if np.std(one.values[part]) < 0.35 * np.sqrt(np.mean(one.values[part] ** 2)):
        raise Unfit("a mere step")
    return Contribution(one.effect, values, one.drivers, one.params, active=mask, where=where)


def measure(rng: np.random.Generator, bench: Bench, story: Story, step: float) -> None:
    """Fill in what is recorded, on a display of `step`, and what the simulation says."""
    n = bench.rows
    truth = (
        story.datum
        + sum((c.values for c in story.included), np.zeros(n))
        + sum((c.values for c in story.hidden), np.zeros(n))
    )
    story.simulated = np.round(
        sum((g * c.values for c, g in zip(story.included, story.gains, strict=True)), np.zeros(n)), 3
    )
    story.step = chain.fit_step(step, story.noise)
    story.truth = truth
    noisy = truth + chain.correlated(rng, n, story.noise)
    story.clean = chain.display(noisy, story.step)
    share = rng.uniform(0.2, 1.9) * bench.spikes if rng.random() < 0.8 else 0.0
    story.error = chain.display(noisy + chain.outliers(rng, n, story.noise, share), story.step)


def oracle(bench: Bench, story: Story) -> tuple[float, float, float]:
    """rms before, noise, and held-out rms with the hidden part added and the gains fitted."""
    rows = np.flatnonzero(bench.measured)
    mismatch = (story.clean - story.simulated)[rows]
    noise = float(np.sqrt(np.mean((story.clean - story.truth)[rows] ** 2)))
    left = mismatch - sum((c.values[rows] for c in story.hidden), np.zeros(rows.size))
    design = np.column_stack([np.ones(rows.size), *(c.values[rows] for c in story.included)])
    design = design / np.maximum(np.abs(design).max(axis=0), 1e-12)
    runs = np.array(bench.run)[rows]
    labels = list(dict.fromkeys(runs.tolist()))
    groups = [runs == r for r in labels] if len(labels) > 3 else np.array_split(np.arange(rows.size), 6)
    total, count = 0.0, 0
    everything = np.ones(rows.size, bool)
    for group in groups:
        train = everything.copy()
        train[group] = False
        fit = np.linalg.lstsq(design[train], left[train], rcond=1e-10)[0]
        out = left[group] - design[group] @ fit
        total, count = total + float(out @ out), count + out.size
    return float(np.sqrt(np.mean(mismatch**2))), noise, float(np.sqrt(total / count))


def key_of(bench: Bench, story: Story, tier: str) -> dict[str, Any]:
    """The key of one response; raises Unfit where the case would not be fair."""
    before, noise, after = oracle(bench, story)
    if after > ORACLE * noise:
        raise Unfit("not even the truth explains it")
    key: dict[str, Any] = {
        "unit": story.response.unit,
        "verdict": ["no_mismatch"],
        "effects": [],
        "truth": [],
        "drivers": {},
        "where": None,
        "params": {},
        "before_rms": round(before, 4),
        "oracle_after_rms": round(after, 4),
        "noise_rms": round(noise, 4),
        "in_the_simulation": {c.effect: g for c, g in zip(story.included, story.gains, strict=True)},
    }
    if not story.hidden:
        key["verdict"] = ["no_mismatch" if story.exact else "recalibrate"]
        return key
    included = np.column_stack([c.values for c in story.included])
    included = included / np.maximum(np.abs(included).max(axis=0), 1e-12)
    key["verdict"] = ["missing_physics"]
    key["truth"] = [c.effect for c in story.hidden]
    for c in story.hidden:
        _one_effect(bench, story, c, included, noise, tier, key)
    if len(key["effects"]) == 2 and set(key["effects"][0]) & set(key["effects"][1]):
        raise Unfit("two effects that pass for each other")
    if len(story.hidden) == 1 and story.hidden[0].where:
        key["where"] = story.hidden[0].where
    if tier == "novel":
        key["verdict"] = ["unexplained", "missing_physics"]
        key["effects"], key["drivers"] = [["unknown"]], {}
    return key


def _one_effect(
    bench: Bench, story: Story, c: Contribution, included: Array, noise: float, tier: str, key: dict
) -> None:
    rows = bench.measured
    rivals = np.hstack([included, *(h.values[:, None] for h in story.hidden if h is not c)])
    base = rivals[rows] - rivals[rows].mean(axis=0)
    target = c.values[rows] - c.values[rows].mean()
    if base.shape[1] and c.active is None:
        left = target - base @ np.linalg.lstsq(base, target, rcond=1e-10)[0]
        if np.sqrt(np.mean(left**2)) * np.sqrt(rows.sum()) < 12 * noise or np.mean(left**2) < 0.05 * np.mean(target**2):
            raise Unfit("the gains can play the hidden effect")
    verdict = compare(bench, story.response.component, c, rivals, noise, rows, tier == "partial")
    if verdict.own_share < LEAST_OWN and c.effect not in NO_FORM and tier != "novel":
        raise Unfit("too far from its own signature")
    if tier == "novel":
        if verdict.best[1] > MOSTLY_EXPLAINED:
            raise Unfit(f"{verdict.best[0]} explains the novel mechanism")
        return
    if len(verdict.accepted) > 3:
        raise Unfit("anything would do")
    key["effects"].append(verdict.accepted)
    key["drivers"].update({e: verdict.drivers.get(e, []) for e in verdict.accepted})
    acts = rows & c.active if c.active is not None else rows
    for name, (value, unit, grows) in c.params.items():
        if name == "tau":
            if verdict.tau is None or verdict.own_share < 0.985:
                continue
            value = sharpened(bench, c.drivers[0], verdict.tau, c.values, rows)
        elif grows:
            value = c.size_in_the_textbook(value, acts)
        key["params"][f"{c.effect}.{name}"] = {"value": round(abs(value), 5), "unit": unit}


def build(rng: np.random.Generator, bench: Bench, tier: str, wanted: str | None) -> tuple[dict, list[Story]]:
    """The key's responses and the stories; may raise Unfit."""
    names = list(bench.responses)
    able = [n for n in names if wanted is None or wanted in (bench.responses[n].hideable or bench.responses[n].effects)]
    if not able:
        raise Unfit(f"{wanted} does not occur on this bench")
    chosen = None if tier == "null" else str(rng.choice(able))
    stories, keys = [], {}
    step = float(rng.choice(STEPS["N" if bench.responses[names[0]].unit == "N" else bench.protocol]))
    exact_all = tier == "null" and rng.random() < 0.4
    for name in names:
        response = bench.responses[name]
        story = (
            hide(rng, bench, response, tier, wanted)
            if name == chosen
            else quiet(rng, bench, response, "exact" if exact_all else None)
        )
        measure(rng, bench, story, step)
        keys[name] = key_of(bench, story, tier)
        stories.append(story)
    return keys, stories
