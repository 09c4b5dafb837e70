"""Draw blind cases: python -m trials.second.generate OUT --seed N --cases 72 (see --help)."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from . import circular, cutting, grid, positioning, spindle, trace
from .compose import bare, build, clock
from .key import Case, Unfit
from .scene import Scene
from .textbook import Book
from .write import write_case

Rng = np.random.Generator
SCENES = {
    "linear positioning": positioning.scene,
    "spindle drift": spindle.scene,
    "circular test": circular.scene,
    "feedback trace": trace.scene,
    "volumetric grid": grid.scene,
    "cutting series": cutting.scene,
}
TIERS = {"plain": 0.42, "concealed": 0.17, "pair": 0.11, "partial": 0.06, "null": 0.15, "novel": 0.09}
SHARES = {
    "linear positioning": 0.26,
    "spindle drift": 0.24,
    "circular test": 0.12,
    "feedback trace": 0.14,
    "volumetric grid": 0.11,
    "cutting series": 0.13,
}
PATIENCE = 60  # draws before another protocol may take a case
CLOCKED = {"spindle drift": 1.0, "feedback trace": 0.25}


def tier_list(rng: Rng, cases: int, tiers: list[str]) -> list[str]:
    """Tiers in the shares of `TIERS`, shuffled."""
    share = np.array([TIERS[t] for t in tiers])
    count = np.floor(share / share.sum() * cases).astype(int)
    while count.sum() < cases:
        count[int(np.argmax(share / share.sum() * cases - count))] += 1
    out = [t for t, n in zip(tiers, count, strict=True) for _ in range(n)]
    rng.shuffle(out)
    return out


class Dealer:
    """Deals protocols and effects so that none comes too often."""

    def __init__(self, rng: Rng, protocols: list[str], effects: list[str] | None):
        self.rng, self.protocols, self.wanted = rng, protocols, effects
        self.seen: dict[str, int] = {}

    def protocol(self) -> str:
        p = np.array([SHARES[n] for n in self.protocols])
        return str(self.rng.choice(self.protocols, p=p / p.sum()))

    def pick(self, names: list[str]) -> str:
        if self.wanted:
            names = [n for n in names if n in self.wanted]
        if not names:
            raise Unfit("no wanted effect in this scene")
        weight = np.array([1.0 / (1 + 2 * self.seen.get(n, 0)) ** 2 for n in names])
        return str(self.rng.choice(names, p=weight / weight.sum()))

    def count(self, names: list[str]) -> None:
        for n in names:
            self.seen[n] = self.seen.get(n, 0) + 1


def draw(rng: Rng, tier: str, dealer: Dealer, protocol: str) -> tuple[Scene, list[Case], list[str]]:
    """One case of a tier; Unfit when the draw breaks a rule."""
    scene = SCENES[protocol](rng)
    if tier == "null":
        return scene, null_case(rng, scene), []
    last = len(scene.responses) - 1  # E_Z, which knows most mechanisms
    main = last if rng.random() < 0.3 else int(rng.integers(last + 1))
    response = scene.responses[main]
    hidden = hide(rng, response, tier, dealer, protocol)
    if hidden == ["clock_offset"]:
        case = clock(rng, scene, response, tier, Book(scene))
    else:
        case = build(rng, scene, response, hidden, tier, Book(scene))
    cases = []
    for i, r in enumerate(scene.responses):
        cases.append(case if i == main else bare(rng, scene, r, str(rng.choice(["exact", "exact", "one", "each"]))))
    return scene, cases, hidden


def hide(rng: Rng, response, tier: str, dealer: Dealer, protocol: str) -> list[str]:
    names = [e for e in response.makers if e not in response.always]
    if tier == "novel":
        return [str(rng.choice(list(response.novel)))]
    if tier == "plain" and rng.random() < CLOCKED.get(protocol, 0.0):
        names.append("clock_offset")
    if tier == "partial":
        names = [n for n in names if n not in ("local_wear", "sensor_fault", "reversal_spike", "sensor_drift")]
    if tier == "concealed":
        names = [n for n in names if n not in ("sensor_fault", "local_wear", "reversal_spike")]
    if tier == "pair":
        names = [n for n in names if n not in ("sensor_fault",)]
        first = dealer.pick(names)
        rest = [n for n in names if n != first]
        return [first, str(rng.choice(rest))]
    return [dealer.pick(names)]


def null_case(rng: Rng, scene: Scene) -> list[Case]:
    kind = str(rng.choice(["exact", "one", "each", "datum"], p=[0.4, 0.25, 0.25, 0.1]))
    kinds = [kind] + ["exact" if kind == "exact" else str(rng.choice(["exact", kind])) for _ in scene.responses[1:]]
    rng.shuffle(kinds)
    return [bare(rng, scene, r, k) for r, k in zip(scene.responses, kinds, strict=True)]


def cases(
    seed: int, count: int, tiers: list[str], effects: list[str] | None = None, protocols: list[str] | None = None
) -> Iterator[tuple[str, str, Scene, list[Case], Rng]]:
    """`count` cases: (opaque id, tier, scene, responses, generator of what the log does to it)."""
    root = np.random.default_rng([seed, 20261121])
    dealer = Dealer(root, protocols or list(SCENES), effects)
    for number, tier in enumerate(tier_list(root, count, tiers)):
        protocol = dealer.protocol()
        for attempt in range(400):
            if attempt >= PATIENCE or effects:
                protocol = dealer.protocol()
            rng = np.random.default_rng([seed, number, attempt])
            try:
                scene, draw_result, hidden = draw(rng, tier, dealer, protocol)
            except Unfit:
                continue
            dealer.count(hidden)
            name = hashlib.sha256(f"second {seed} {number}".encode()).hexdigest()[:10]
            yield name, tier, scene, draw_result, rng
            break
        else:
            raise RuntimeError(f"no fair case of tier {tier} in 400 draws (effects {effects}, protocols {protocols})")


def main(argv: list[str] | None = None) -> int:
    ap = argparse.ArgumentParser(description="Draw blind cases with their keys.")
    ap.add_argument("out", type=Path)
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--cases", type=int, default=72)
    ap.add_argument("--tiers", nargs="+", default=list(TIERS), choices=list(TIERS))
    ap.add_argument("--effects", nargs="+")
    ap.add_argument("--protocols", nargs="+", choices=list(SCENES))
    a = ap.parse_args(argv)
    for name, tier, scene, match, rng in cases(a.seed, a.cases, a.tiers, a.effects, a.protocols):
        write_case(a.out / name, name, tier, scene, match, rng)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
