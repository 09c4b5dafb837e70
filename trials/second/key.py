"""The key of one response: what it accepts, which columns drive it, how well an oracle does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from .noise import display_step, measuring_noise, outliers
from .scene import Part, Response, Scene, rms
from .textbook import Book

Rng = np.random.Generator
RULED_OUT = 14.0  # sum of squares left, in variances of the noise
OWN_LEFT = 0.8  # of the noise: what the right name's textbook form may leave
NOVEL_LEFT = 0.5  # of a novel mechanism: what any named effect must leave
FORMLESS = {"sensor_fault", "clock_offset"}


class Unfit(Exception):
    """This draw breaks a rule of fairness; draw again."""


@dataclass
class Case:
    """One response, ready to be written: recorded, simulated, and its key."""

    component: str
    recorded: np.ndarray
    simulated: np.ndarray
    key: dict
    cells: dict[str, np.ndarray] = field(default_factory=dict)
    needs: list[str] = field(default_factory=list)


@dataclass
class Mix:
    """What acts in one response."""

    response: Response
    noise: float
    hidden: list[Part]
    included: list[Part]
    gains: np.ndarray
    datum: float = 0.0
    sim: np.ndarray | None = None

    def truth(self) -> np.ndarray:
        acts = [p.values for p in self.hidden if not p.in_sim]
        return sum(acts + [p.values for p in self.included])

    def simulated(self) -> np.ndarray:
        if self.sim is not None:
            return self.sim
        wrong = [-self.gains[0] * p.values for p in self.hidden if p.in_sim]  # its own physics comes first
        return sum(wrong + [g * p.values for g, p in zip(self.gains, self.included, strict=True)])


def base_runs(runs: np.ndarray) -> np.ndarray:
    return np.array([r[1:] if r.startswith("w") else r for r in runs.tolist()])


def centred(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return values[rows] - values[rows].mean()


def unexplained(target: np.ndarray, design: np.ndarray) -> np.ndarray:
    q, r = np.linalg.qr(design)
    q = q[:, np.abs(np.diag(r)) > 1e-9 * max(np.abs(np.diag(r)).max(), 1e-30)]
    return target - q @ (q.T @ target)


def nuisance(mix: Mix, rows: np.ndarray, besides: Part | None = None) -> np.ndarray:
    cols = (
        [np.ones(rows.sum())]
        + [p.values[rows] for p in mix.included]
        + [p.values[rows] for p in mix.hidden if p is not besides]
    )
    return scale_columns(np.column_stack(cols))


def scale_columns(m: np.ndarray) -> np.ndarray:
    return m / np.maximum(np.sqrt((m**2).mean(0)), 1e-12)


def accepted(book: Book, mix: Mix, part: Part, rows: np.ndarray, tier: str) -> tuple[list[str], dict[str, list[str]]]:
    """Ids that the key accepts for a hidden effect, and the drivers of each.

    A rival explains at least 97 % of the hidden contribution, or leaves so little beside the included physics that
    the noise cannot rule it out. In tier partial the rivals may be confined to the same rows.
    """
    pick = rows[book.keep]
    mask = np.zeros(len(rows), bool)
    mask[book.keep[pick]] = True
    scale = rows.sum() / max(mask.sum(), 1)
    c, base = part.values[mask], nuisance(mix, mask, part)
    alone = np.sum((c - c.mean()) ** 2)
    ids, drivers = [part.effect], {part.effect: list(part.drivers)}
    for effect, names, form in rivals(book, mix, tier, part, pick, mask):
        b = scale_columns(form - form.mean(0))
        rest = np.sum(unexplained(c - c.mean(), b) ** 2)
        good = rest <= 0.03 * alone
        if not good and rest < 0.5 * alone:
            left = unexplained(c, np.hstack([base, b]))
            good = scale * np.sum(left**2) < RULED_OUT * mix.noise**2
        if good:
            if effect not in ids:
                ids.append(effect)
            known = drivers.setdefault(effect, [])
            known += [n for n in names if n not in known and n in book.scene.columns]
    return ids, drivers


def nearest(book: Book, mix: Mix, part: Part, rows: np.ndarray, tier: str, effect: str | None = None) -> float:
    """Rms of a hidden part that the best textbook form (of one effect, or of any) leaves beside the included."""
    pick = rows[book.keep]
    mask = np.zeros(len(rows), bool)
    mask[book.keep[pick]] = True
    c, base = part.values[mask], nuisance(mix, mask, part)
    left = [
        rms(unexplained(c, np.hstack([base, scale_columns(form - form.mean(0))])))
        for name, _, form in rivals(book, mix, tier, part, pick, mask)
        if effect in (None, name)
    ]
    return min(left, default=np.inf)


def rivals(book: Book, mix: Mix, tier: str, part: Part, pick: np.ndarray, mask: np.ndarray) -> Iterator[tuple]:
    """Textbook forms on the kept rows, a clock's offset among them."""
    for effect, names, form in book.forms(mix.response.component):
        b = form[pick]
        yield effect, names, b
        if tier == "partial":
            yield effect, names, b * part.acting[mask][:, None]
    if book.scene.protocol == "spindle drift":
        total, t = sum(p.values for p in mix.included), book.t
        for shift in (-600, -300, -100, 100, 300, 600):
            yield "clock_offset", ["t"], (np.interp(t - shift, t, total) - total)[mask, None]


def oracle(mix: Mix, recorded: np.ndarray, simulated_parts: list[Part], rows: np.ndarray, runs: np.ndarray) -> float:
    """Held-out rms with every true contribution known and its factor fitted: over runs, or six blocks."""
    idx = np.flatnonzero(rows)
    labels = base_runs(runs)[idx]
    if len(set(labels.tolist())) < 3:
        labels = np.arange(len(idx)) * 6 // len(idx)
    design = np.column_stack([np.ones(len(idx))] + [p.values[idx] for p in simulated_parts])
    y, out = recorded[idx], np.zeros(len(idx))
    for fold in dict.fromkeys(labels.tolist()):
        test = labels == fold
        q = np.linalg.lstsq(design[~test], y[~test], rcond=None)[0]
        out[test] = y[test] - design[test] @ q
    return rms(out)


def finish(rng: Rng, scene: Scene, mix: Mix, tier: str, book: Book | None) -> Case:
    """Noise, display, and the key of one response."""
    rows = scene.measured()
    _settle(scene, mix)
    unit = measuring_noise(rng, scene.rows)
    step = display_step(rng, mix.response.step, mix.noise)
    sim = np.round(mix.simulated(), 2 if mix.response.unit == "N" else 3)
    wild = outliers(rng, scene.rows) * mix.noise
    clean = mix.truth() + mix.datum + mix.noise * unit
    recorded = np.round(np.round((clean + wild) / step) * step, 6)
    tame = rows & (wild == 0)
    quiet = np.round(clean / step) * step
    noise = rms((quiet - mix.truth() - mix.datum)[tame])
    after = oracle(mix, quiet, [p for p in mix.hidden if not p.in_sim] + mix.included, tame, scene.runs)
    if mix.hidden and after > 1.15 * noise:
        raise Unfit("the oracle cannot find it either")
    key = {
        "unit": mix.response.unit,
        "verdict": verdict(mix, tier),
        "effects": [],
        "truth": [],
        "drivers": {},
        "where": None,
        "params": {},
        "before_rms": round(rms((quiet - sim)[tame]), 4),
        "oracle_after_rms": round(after, 4),
        "noise_rms": round(noise, 4),
        "in_the_simulation": {p.effect: round(float(g), 4) for p, g in zip(mix.included, mix.gains, strict=True)},
    }
    cells = {}
    if follows(scene, mix):
        scene.columns["x"].values = scene.columns["x_cmd"].values + clean / 1000
    for part in mix.hidden:
        _key_of(key, book, mix, part, tame, tier)
        cells |= part.cells
    needs = [d for p in mix.hidden + mix.included for d in p.drivers]
    return Case(mix.response.component, recorded, sim, key, cells, needs)


def follows(scene: Scene, mix: Mix) -> bool:
    """Whether the deviation is the axis' own: then its position shows it."""
    return scene.protocol == "feedback trace" and mix.response.component == "EXX"


def _settle(scene: Scene, mix: Mix) -> None:
    """Periods as short as the deviations are periods of where the axis is, not of where it was told to be."""
    if not follows(scene, mix):
        return
    others = sum(p.values for p in mix.hidden + mix.included if p.again is None)
    x = scene.columns["x_cmd"].values + others / 1000
    for part in mix.hidden + mix.included:
        if part.again is not None:
            part.values = part.again(x)


def _key_of(key: dict, book: Book, mix: Mix, part: Part, rows: np.ndarray, tier: str) -> None:
    if tier == "novel":
        if nearest(book, mix, part, rows, tier) < max(
            NOVEL_LEFT * rms(part.values[rows] - part.values[rows].mean()), mix.noise
        ):
            raise Unfit("a named effect explains it")
        key["effects"].append(["unknown"])
        key["truth"].append(part.truth)
        return
    if part.effect not in FORMLESS and nearest(book, mix, part, rows, tier, part.effect) > OWN_LEFT * mix.noise:
        raise Unfit("far from its own signature")
    ids, drivers = accepted(book, mix, part, rows, tier)
    key["effects"].append(ids)
    key["truth"].append(part.effect)
    for name, columns in drivers.items():
        key["drivers"].setdefault(name, columns)
    key["params"] |= {k: {"value": round(v, 5), "unit": u} for k, (v, u) in part.params.items()}
    if part.where:
        key["where"] = part.where


def verdict(mix: Mix, tier: str) -> list[str]:
    if tier == "novel" and mix.hidden:
        return ["unexplained", "missing_physics"]
    if mix.hidden:
        return ["missing_physics"]
    return ["no_mismatch"] if np.all(mix.gains == 1) and mix.datum == 0 and mix.sim is None else ["recalibrate"]
