"""From a scene to a case: what is hidden, what the simulation holds and how wrong, how loud the noise is, the key."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .climate import sign, window
from .key import Case, Mix, Unfit, base_runs, centred, finish, nuisance, unexplained
from .scene import Part, Response, Scene, rms
from .textbook import Book

Rng = np.random.Generator
FOUND = 0.4  # of the noise: what a hidden effect must leave beside other gains
# effect -> physics that resembles it, for tier concealed
ALIKE = {
    "backlash": ["screw_windup", "friction_hysteresis", "reversal_spike", "following_error"],
    "screw_windup": ["backlash"],
    "friction_hysteresis": ["backlash", "reversal_spike", "following_error"],
    "reversal_spike": ["backlash", "friction_hysteresis"],
    "scale_error": ["scale_expansion", "squareness", "angular_abbe"],
    "scale_expansion": ["scale_error", "feed_heating", "air_refraction"],
    "feed_heating": ["scale_expansion", "scale_error"],
    "air_refraction": ["scale_expansion", "scale_error"],
    "thermal_drift": ["thermal_lag", "ambient_drift", "spindle_growth"],
    "thermal_lag": ["thermal_drift", "spindle_growth", "ambient_drift"],
    "ambient_drift": ["thermal_drift", "sensor_drift"],
    "spindle_growth": ["thermal_drift", "thermal_lag", "centrifugal_growth"],
    "centrifugal_growth": ["spindle_growth"],
    "thermal_interaction": ["thermal_drift"],
    "gradient_bending": ["thermal_drift", "ambient_drift"],
    "coolant_effect": ["thermal_drift", "ambient_drift"],
    "servo_mismatch": ["squareness", "backlash"],
    "squareness": ["servo_mismatch", "angular_abbe", "straightness"],
    "straightness": ["squareness", "gravity_sag"],
    "angular_abbe": ["squareness", "scale_error"],
    "gravity_sag": ["straightness", "squareness", "workpiece_load"],
    "workpiece_load": ["gravity_sag"],
    "coulomb_friction": ["stribeck_friction", "viscous_friction"],
    "viscous_friction": ["coulomb_friction"],
    "stribeck_friction": ["coulomb_friction"],
    "cutting_compliance": ["tool_wear"],
    "tool_wear": ["cutting_compliance", "sensor_drift"],
    "following_error": ["backlash", "friction_hysteresis"],
    "inertial_deflection": ["following_error"],
    "local_wear": ["scale_error", "pitch_cyclic"],
    "sensor_drift": ["ambient_drift", "thermal_drift"],
}


def include(
    rng: Rng, response: Response, hidden: list[Part], want: list[str], noise: float, rows: np.ndarray, count: int
) -> list[Part]:
    """Physics of the simulation: what goes along with the hidden, `want`, then others, each 2 to 30 times the noise."""
    parts = [a for p in hidden for a in p.along]
    avoid = {p.effect for p in hidden + parts} | {"sensor_fault", "sensor_drift"}
    pool = [e for e in response.makers if e not in avoid]
    rng.shuffle(pool)
    names = list(dict.fromkeys([*response.always, *[w for w in want if w in pool], *pool]))[:count]
    for n in names:
        part = response.makers[n](rng)
        size = rms(centred(part.values, rows)) if part is not None else 0.0
        if size < 1e-9:
            continue
        low, high = (60, 250) if n == "moving_mass" else (2.0, 30.0)
        goal = float(np.clip(size, low * noise, high * noise))
        parts.append(part.scaled(goal / size))
    if not parts:
        raise Unfit("no physics to include")
    return parts


def size_of(part: Part, rows: np.ndarray) -> float:
    """Rms that counts: about the mean, or over the rows in which a brief or local mechanism acts."""
    if part.acting is not None:
        acting = rows & part.acting
        if acting.sum() < 12:
            raise Unfit("acts nowhere")
        return rms(part.values[acting])
    return rms(centred(part.values, rows))


def draw_gains(rng: Rng, n: int, mode: str) -> np.ndarray:
    if mode == "exact":
        return np.ones(n)
    off = rng.choice([-1, 1], n) * rng.uniform(0.02, 0.15, n)
    if mode == "one":
        off[:] = rng.choice([-1, 1]) * rng.uniform(0.06, 0.15)
    return np.round(1 + off, 4)


def gain_part(mix: Mix, rows: np.ndarray) -> float:
    off = sum((1 - g) * p.values for g, p in zip(mix.gains, mix.included, strict=True))
    return rms(centred(off, rows))


def shrink_gains(gains: np.ndarray, factor: float) -> np.ndarray:
    return np.round(np.clip(1 + (gains - 1) * factor, 0.85, 1.15), 4)


def faint(rng: Rng, low: float, high: float) -> float:
    """A ratio to the noise, mostly near its lower end."""
    return low + (high - low) * rng.random() ** 2.2


def limit(rng: Rng, scene: Scene, part: Part) -> Part:
    """The same mechanism in some runs or on one stretch only (tier partial)."""
    rows = scene.measured()
    if scene.protocol in ("linear positioning", "volumetric grid") and rng.random() < 0.4:
        x = scene.columns["x"].values
        a = rng.uniform(0.05, 0.5)
        lo, hi = np.quantile(x[rows], [a, a + rng.uniform(0.3, 0.45)])
        mask, where = (x >= lo) & (x <= hi), {"ranges": {"x": [round(float(lo), 1), round(float(hi), 1)]}}
    else:
        mask, where = window(rng, scene.columns["t"].values, base_runs(scene.runs))
    if (mask & rows).sum() < 40 or (~mask & rows).sum() < 40:
        raise Unfit("no room for a part")
    values = np.where(mask, part.values, 0.0)
    again = (lambda x: np.where(mask, part.again(x), 0.0)) if part.again else None
    return replace(part, values=values, acting=mask, where=where, again=again)


def fair(mix: Mix, rows: np.ndarray, tier: str) -> None:
    """Other gains on the included physics cannot play a hidden effect, and what they leave stands above the noise."""
    for part in mix.hidden:
        left = unexplained(part.values[rows], nuisance(mix, rows, part))
        whole = centred(part.values, rows)
        if rms(left) < (0.5 if tier == "concealed" else 0.55) * rms(whole):
            raise Unfit("other gains play the hidden effect")
        if np.sum(left**2) < (mix.noise**2) * max(FOUND**2 * rows.sum(), 80):
            raise Unfit("too faint to be found")


def build(rng: Rng, scene: Scene, response: Response, hidden: list[str], tier: str, book: Book) -> Case:
    """One response in which something is hidden."""
    rows = scene.measured()
    mix = _mix(rng, scene, response, hidden, tier, rows)
    return finish(rng, scene, mix, tier, book)


def _mix(rng: Rng, scene: Scene, response: Response, hidden: list[str], tier: str, rows: np.ndarray) -> Mix:
    parts = [response.novel[h](rng) if tier == "novel" else response.makers[h](rng) for h in hidden]
    if any(p is None for p in parts):
        raise Unfit("this scene has no such mechanism")
    if "feed_heating" in hidden and not scene.logging.any():
        raise Unfit("nobody logged how the axis moved")
    if tier == "partial":
        parts = [limit(rng, scene, p) for p in parts]
    ratio = [faint(rng, 2.0, 4.8) for _ in parts]
    size = [size_of(p, rows) for p in parts]
    if min(size) < 1e-6:
        raise Unfit("nothing happens")
    noise = float(np.clip(size[0] / ratio[0], *response.scale))
    factors = [r * noise / s for r, s in zip(ratio, size, strict=True)]
    if tier != "novel" and not all(0.25 < f < 4 for f in factors):
        raise Unfit("not a typical size")
    parts = [p.scaled(f) for p, f in zip(parts, factors, strict=True)]
    want = [e for h in hidden for e in ALIKE.get(h, [])]
    rng.shuffle(want)
    count = int(rng.integers(2, 5))
    included = include(rng, response, parts, want[:2] if tier == "concealed" else [], noise, rows, count)
    mode = "one" if rng.random() < 0.18 and tier != "concealed" else "each"
    mix = Mix(response, noise, parts, included, draw_gains(rng, len(included), mode))
    if rng.random() < 0.75:
        mix.datum = rng.normal(0, 2.0) * noise
    _balance(rng, mix, rows, tier)
    fair(mix, rows, tier)
    return mix


def _balance(rng: Rng, mix: Mix, rows: np.ndarray, tier: str) -> None:
    """Wrong gains: less than the hidden effect, or (concealed) one to two times as much."""
    rest = gain_part(mix, rows)
    if tier == "concealed":
        part = mix.hidden[0]
        goal = size_of(part, rows)
        share = rng.uniform(0.5, 1.0)
        part = part.scaled(faint(rng, 1.1, 2.8) * mix.noise / goal)
        need = size_of(part, rows) / share
        mix.gains = shrink_gains(mix.gains, need / max(rest, 1e-12))
        rest = gain_part(mix, rows)
        if not 0.97 * size_of(part, rows) <= rest <= 2.03 * size_of(part, rows):
            raise Unfit("gains cannot conceal it")
        mix.hidden = [part]
        return
    smallest = min(rms(centred(p.values, rows)) for p in mix.hidden)
    if rest > smallest:
        mix.gains = shrink_gains(mix.gains, rng.uniform(0.5, 0.98) * smallest / rest)


def bare(rng: Rng, scene: Scene, response: Response, kind: str) -> Case:
    """A response from which nothing is missing: exact, one gain, a gain for each term, or a datum."""
    rows = scene.measured()
    noise = float(np.exp(rng.uniform(*np.log(response.scale))))
    included = include(rng, response, [], [], noise, rows, int(rng.integers(2, 5)))
    mix = Mix(response, noise, [], included, np.ones(len(included)))
    if kind in ("one", "each"):
        mix.gains = draw_gains(rng, len(included), kind)
        rest = gain_part(mix, rows)
        goal = faint(rng, 1.2, 6.0) * noise
        mix.gains = shrink_gains(mix.gains, goal / max(rest, 1e-12))
        if gain_part(mix, rows) < 0.9 * noise:
            raise Unfit("gains hardly matter")
        mix.datum = rng.normal(0, 2.0) * noise if rng.random() < 0.7 else 0.0
    if kind == "datum":
        mix.datum = sign(rng) * faint(rng, 1.5, 6.0) * noise
    return finish(rng, scene, mix, "null", None)


def clock(rng: Rng, scene: Scene, response: Response, tier: str, book: Book) -> Case:
    """Recording and simulation by two clocks: the simulation comes late or early."""
    rows, t = scene.measured(), scene.columns["t"].values
    noise = float(np.exp(rng.uniform(*np.log(response.scale))))
    included = include(rng, response, [], list(response.makers)[:3], noise, rows, int(rng.integers(2, 5)))
    mix = Mix(response, noise, [], included, draw_gains(rng, len(included), "each"))
    trace = scene.protocol == "feedback trace"
    shift = sign(rng) * (rng.uniform(0.01, 0.08) if trace else np.exp(rng.uniform(np.log(90), np.log(600))))

    def shifted(values: np.ndarray) -> np.ndarray:
        out = np.empty_like(values)
        for r in np.unique(scene.runs):
            k = scene.runs == r
            out[k] = np.interp(t[k] - shift, t[k], values[k])
        return out

    total = sum(p.values for p in included)
    moved = sum(shifted(p.values) for p in included)
    delta = total - moved
    want = faint(rng, 2.0, 4.5)
    fit = noise * want / max(rms(centred(delta, rows)), 1e-12)
    mix.included = included = [p.scaled(fit) for p in included]
    delta = delta * fit
    off = sum((g - 1) * shifted(p.values) for g, p in zip(mix.gains, included, strict=True))
    over = rms(centred(off, rows)) / max(rms(centred(delta, rows)), 1e-12)
    if over > 0.95:
        mix.gains = shrink_gains(mix.gains, 0.9 / over)
    mix.sim = sum(g * shifted(p.values) for g, p in zip(mix.gains, included, strict=True))
    part = Part("clock_offset", delta, ["t"], {"clock_offset.offset": (abs(shift), "s")})
    mix.included = [Part(p.effect, shifted(p.values), p.drivers) for p in included]
    mix.hidden = [part]
    fair(mix, rows, tier)
    return finish(rng, scene, mix, tier, book)
