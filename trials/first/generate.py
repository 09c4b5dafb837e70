"""Draw blind cases.

    python -m trials.first.generate OUT_DIR --seed 7 --cases 130 [--tiers plain,null] [--effects backlash]
                                    [--protocols "circular test"]

Writes OUT_DIR/cases/<id>/{recording.yaml,recording.csv}, OUT_DIR/answers/<id>.json and OUT_DIR/answers.sha256.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from trials.command import in_shares

from . import chain, circle, cutting, feedback, grid, linear, spindle
from .assemble import Story, Unfit, build
from .case import Bench

PROTOCOLS: dict[str, Callable[[np.random.Generator], Bench]] = {
    "linear positioning": linear.make,
    "spindle drift": spindle.make,
    "circular test": circle.make,
    "feedback trace": feedback.make,
    "volumetric grid": grid.make,
    "cutting series": cutting.make,
}
MIX = {"plain": 0.42, "concealed": 0.16, "pair": 0.12, "partial": 0.08, "null": 0.13, "novel": 0.09}
TRIES = 60


def opaque(seed: int, number: int) -> str:
    return hashlib.sha256(f"errpipe trial {seed} {number}".encode()).hexdigest()[:10]


def occurring() -> dict[str, list[str]]:
    """Which protocols can hide which effect (from one bench of each)."""
    out: dict[str, list[str]] = {}
    for name, make in PROTOCOLS.items():
        for seed in range(4):
            for response in make(np.random.default_rng(seed)).responses.values():
                for effect in response.hideable or response.effects:
                    if name not in out.setdefault(effect, []):
                        out[effect].append(name)
    return out


def one_case(
    seed: int, number: int, tier: str, effect: str | None, protocols: list[str]
) -> tuple[dict, Bench, list[Story], np.random.Generator]:
    """Draw until fair; deterministic in (seed, number)."""
    why = "no try"
    for attempt in range(TRIES):
        rng = np.random.default_rng([seed, number, attempt])
        protocol = str(rng.choice(protocols))
        bench = PROTOCOLS[protocol](rng)
        try:
            responses, stories = build(rng, bench, tier, effect)
        except Unfit as reason:
            why = str(reason)
            continue
        return (
            {"case": opaque(seed, number), "tier": tier, "protocol": protocol, "responses": responses},
            bench,
            stories,
            rng,
        )
    raise RuntimeError(f"case {number} ({tier}, {effect}, {protocols}): {why}")


def write_case(folder: Path, bench: Bench, stories: list[Story], rng: np.random.Generator) -> None:
    """The recording as a user would find it."""
    folder.mkdir(parents=True)
    specs: dict[str, dict] = {"run": {"role": "run"}}
    values: dict[str, np.ndarray] = {}
    decimals: dict[str, int] = {}
    used: set[str] = set()
    for story in stories:
        for c in [*story.included, *story.hidden]:
            used |= set(c.drivers)
            if c.display:
                bench.columns[c.display[0]].values = c.display[1]
        if story.response.follow:
            follow = bench.columns[story.response.follow]
            follow.values = follow.values + story.clean / 1e3
    for name, column in bench.columns.items():
        specs[name], values[name], decimals[name] = column.spec, chain.shown_column(rng, column), column.decimals
    errors = []
    for story in stories:
        name, unit = story.response.component, story.response.unit
        specs[name] = {"role": "error", "component": name, "unit": unit}
        specs[f"{name}_sim"] = {"role": "simulated", "component": name, "unit": unit}
        values[name] = np.where(bench.measured, story.error, np.nan)
        values[f"{name}_sim"] = story.simulated
        decimals[name], decimals[f"{name}_sim"] = 2 if story.step < 0.1 else 1, 3
        errors.append(name)
    chain.lose(rng, values, [n for n, c in bench.columns.items() if c.sensor], used, errors)
    keep = chain.order(rng, bench)
    cells = [[bench.run[i] for i in keep]]
    cells += [chain.text(v[keep], decimals[n]) for n, v in values.items()]
    chain.write_table(folder / "recording.csv", ["run", *values], cells)
    chain.write_manifest(folder / "recording.yaml", bench, specs)


def plan(
    seed: int, cases: int, tiers: list[str], effects: list[str] | None, protocols: list[str]
) -> list[tuple[str, str | None, list[str]]]:
    """Tier, effect and protocols of every case; effects take turns so that all of them occur."""
    rng = np.random.default_rng([seed, 999])
    where = {e: [p for p in ps if p in protocols] for e, ps in occurring().items()}
    names = [e for e in (effects or sorted(where)) if where.get(e)]
    if not names:
        raise SystemExit("none of these effects occurs in these protocols")
    out: list[tuple[str, str | None, list[str]]] = []
    turn: dict[str, list[str]] = {}
    for tier in in_shares(rng, MIX, cases, tiers):
        if tier in ("null", "novel"):
            out.append((tier, None, [str(rng.choice(protocols))]))
            continue
        barred = {
            "concealed": {"clock_offset", "sensor_fault"},
            "pair": {"clock_offset", "sensor_fault"},
            "partial": {"clock_offset", "sensor_fault", "sensor_drift", "local_wear", "reversal_spike"},
        }.get(tier, set())
        allowed = [n for n in names if n not in barred] or names
        queue = turn.setdefault(tier, [])
        if not queue:
            queue.extend(allowed)
            rng.shuffle(queue)
        effect = queue.pop()
        out.append((tier, effect, where[effect]))
    return out


def generate(
    out: Path,
    seed: int,
    cases: int,
    tiers: list[str] | None = None,
    effects: list[str] | None = None,
    protocols: list[str] | None = None,
) -> list[str]:
    """Write all cases; the answers' digest is written before anything is read back. Returns the ids."""
    tiers, protocols = tiers or list(MIX), protocols or list(PROTOCOLS)
    (out / "answers").mkdir(parents=True)
    digests, ids = [], []
    for number, (tier, effect, places) in enumerate(plan(seed, cases, tiers, effects, protocols)):
        key, bench, stories, rng = one_case(seed, number, tier, effect, places)
        write_case(out / "cases" / key["case"], bench, stories, rng)
        text = json.dumps(key, indent=1) + "\n"
        (out / "answers" / f"{key['case']}.json").write_text(text)
        digests.append(f"{hashlib.sha256(text.encode()).hexdigest()}  answers/{key['case']}.json")
        ids.append(key["case"])
    (out / "answers.sha256").write_text("\n".join(sorted(digests, key=lambda s: s[66:])) + "\n")
    return ids


def split(text: str | None) -> list[str] | None:
    """A comma-separated option."""
    return [part.strip() for part in text.split(",")] if text else None


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw blind cases.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cases", type=int, default=130)
    parser.add_argument("--tiers", help="comma-separated")
    parser.add_argument("--effects", help="comma-separated effect ids")
    parser.add_argument("--protocols", help="comma-separated")
    a = parser.parse_args()
    ids = generate(a.out, a.seed, a.cases, split(a.tiers), split(a.effects), split(a.protocols))
    print(f"{len(ids)} cases in {a.out}")


if __name__ == "__main__":
    main()
