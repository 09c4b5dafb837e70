"""Draw the cases of the third generator, sealed: python -m trials.run --third --seed N --cases 72."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from trials import folder
from trials.command import in_shares
from trials.folder import Array
from trials.rivals import accepted, forms, possible
from trials.scales.bench import Bench, Rng, log_uniform
from trials.scales.draw import fair_base
from trials.seal import seal

from .machines import MACHINES, outside, strayed
from .noise import kept_rows, noise

TIERS = {"plain": 0.45, "concealed": 0.15, "pair": 0.12, "partial": 0.05, "null": 0.15, "novel": 0.08}
NOVEL_AT_MOST = 0.85  # a mechanism that one textbook form explains so far is not novel
SIZES = {"plain": (2.0, 6.0), "concealed": (0.9, 2.5), "pair": (2.5, 6.0), "partial": (2.5, 6.0), "novel": (2.5, 6.0)}
NOISE_PLAYS = 0.2  # of the hidden effect: what slow noise may add to it by chance; else the recording cannot tell
MOST_ROWS = 20000


class Unfit(Exception):
    """A draw that would not make a fair case: draw again."""


def thinned(rng: Rng, bench: Bench) -> Bench:
    """The rows that a real logger would have kept."""
    rows = kept_rows(rng, len(bench.sheet.table))
    rows = rows[:: -(-rows.size // MOST_ROWS)]
    sheet = replace(bench.sheet, table=bench.sheet.table.iloc[rows].reset_index(drop=True))
    effects = {n: replace(e, values=e.values[rows]) for n, e in bench.effects.items()}
    return replace(bench, sheet=sheet, effects=effects, base=[b[rows] for b in bench.base])


def chosen(rng: Rng, bench: Bench, tier: str, wanted: list[str] | None) -> list[str]:
    """Which effects are hidden."""
    names = [n for n, e in bench.effects.items() if np.std(e.values) > 0 and (not wanted or n in wanted)]
    if not names:
        raise Unfit
    if tier == "pair":
        if len(names) < 2:
            raise Unfit
        return [str(n) for n in rng.choice(names, 2, replace=False)]
    return [str(rng.choice(names))]


def hidden_parts(
    rng: Rng, bench: Bench, tier: str, wanted: list[str] | None
) -> list[tuple[str, Array, tuple[str, ...]]]:
    """(name, values of rms 1, drivers) of what the simulation will lack."""
    if tier == "null":
        return []
    if tier == "novel":
        kind, values, drivers = outside(rng, bench)
        if best_textbook(bench, values) > NOVEL_AT_MOST:
            raise Unfit
        return [(f"outside the vocabulary: {kind}", values, drivers)]
    parts = []
    for name in chosen(rng, bench, tier, wanted):
        e = bench.effects[name]
        parts.append((name, e.values / np.std(e.values), e.drivers))
    if len(parts) == 2 and abs(np.corrcoef(parts[0][1], parts[1][1])[0, 1]) > 0.6:
        raise Unfit
    return parts


def best_textbook(bench: Bench, values: Array) -> float:
    """Share of the sum of squares that the best textbook form explains."""
    y = values - values.mean()
    best = 0.0
    for name, used, design in forms(bench.sheet):
        if possible(name, bench.component, bench.sheet.columns[used[0]].get("axis")):
            x = design - design.mean(axis=0)
            left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
            best = max(best, 1 - float(left @ left) / float(y @ y))
    return best


def one_case(seed: int, number: int, tier: str, machine: str, wanted: list[str] | None) -> tuple[folder.Sheet, dict]:
    """Draw until fair; the same for the same (seed, number)."""
    for attempt in range(80):
        rng = np.random.default_rng([seed, number, attempt, 91])
        try:
            bench = strayed(rng, thinned(rng, MACHINES[machine][1](rng)))
            return compose(rng, bench, tier, wanted, machine)
        except Unfit:
            continue
    raise RuntimeError(f"case {number}: no fair case of tier {tier} on a {machine} in 80 draws")


def compose(rng: Rng, bench: Bench, tier: str, wanted: list[str] | None, machine: str) -> tuple[folder.Sheet, dict]:
    """The recording and its key."""
    parts = hidden_parts(rng, bench, tier, wanted)
    base = fair_base(bench, [n for n, _, _ in parts if n in bench.effects]) or (bench.base if not parts else [])
    if not base:
        raise Unfit
    rows = len(bench.sheet.table)
    scatter, source = noise(rng, rows)
    size = log_uniform(rng, 0.05, 5) if bench.unit in ("N", "N m") else log_uniform(rng, 0.02, 3)
    acts, where, factors = np.zeros(rows), None, []
    for _, values, _ in parts:
        factor = size * rng.uniform(*SIZES[tier])
        factors.append(factor)
        acts = acts + factor * values
    if tier == "partial":
        acts, where = confined(rng, bench, acts)
    if any(
        played_by_noise(size * scatter, values, base) > NOISE_PLAYS * f
        for (_, values, _), f in zip(parts, factors, strict=True)
    ):
        raise Unfit
    off, shares = gains(rng, tier, len(base), size, factors)
    included = [s * b for s, b in zip(shares, base, strict=True)]
    truth = sum(included) + acts + size * scatter
    simulated = sum(g * b for g, b in zip(1 + off, included, strict=True)) + datum(rng, tier, size)
    step = folder.nice_step(size * rng.uniform(0.1, 0.7))
    c = bench.component
    table = bench.sheet.table.assign(
        **{c: folder.rounded(truth, step), f"{c}_sim": folder.rounded(simulated, step / 100)}
    )
    columns = dict(bench.sheet.columns)
    columns[c] = {"role": "error", "component": c, "unit": bench.unit}
    columns[f"{c}_sim"] = {"role": "simulated", "component": c, "unit": bench.unit}
    exact = not parts and not off.any() and abs(float(np.mean(simulated - sum(included)))) < 1e-12
    response = key(replace(bench, base=base), tier, parts, factors, exact, where, size)
    response |= {"noise_rms": float(np.hypot(size, step / 12**0.5)), "unit": bench.unit, "noise_from": source}
    sheet = replace(bench.sheet, table=table, columns=columns)
    return sheet, {"tier": tier, "protocol": machine, "responses": {c: response}}


def played_by_noise(scatter: Array, values: Array, base: list[Array]) -> float:
    """How much of the shape `values` (rms 1) a fit finds in the noise alone, beside a constant and the base."""
    design = np.column_stack([values, *base, np.ones(values.size)])
    return abs(float(np.linalg.lstsq(design, scatter, rcond=None)[0][0]))


def gains(rng: Rng, tier: str, count: int, size: float, factors: list[float]) -> tuple[Array, list[float]]:
    """Errors of the gains on what the simulation holds, and its sizes (rms)."""
    shares = [size * log_uniform(rng, 2, 15) for _ in range(count)]
    if tier == "null" and rng.random() < 0.45:
        return np.zeros(count), shares
    if tier != "concealed" and rng.random() < 0.4:
        return np.zeros(count), shares
    off = rng.uniform(0.03, 0.15, count) * rng.choice([-1, 1], count)
    if rng.random() < 0.35:
        off[:] = off[0]
    if tier == "concealed":  # what the wrong gains cause is larger than what is hidden
        caused = float(np.sqrt(np.sum((off * shares) ** 2)))
        shares = [s * factors[0] / rng.uniform(0.5, 1.0) / caused for s in shares]
    return off, shares


def datum(rng: Rng, tier: str, size: float) -> float:
    """A shifted zero in a third of the cases."""
    return float(size * rng.uniform(-5, 5)) if rng.random() < 1 / 3 and tier != "null" else 0.0


def confined(rng: Rng, bench: Bench, acts: Array) -> tuple[Array, dict]:
    """The effect in some of the runs alone."""
    runs = bench.sheet.runs()
    labels = list(dict.fromkeys(runs.tolist()))
    if len(labels) < 3:
        raise Unfit
    inside = sorted(str(r) for r in rng.choice(labels, max(1, len(labels) // 2), replace=False))
    return np.where(np.isin(runs, inside), acts, 0.0), {"runs": inside}


def key(
    bench: Bench, tier: str, parts: list, factors: list[float], exact: bool, where: dict | None, noise: float
) -> dict:
    """What the judge will accept of this response."""
    if tier == "null":
        verdicts = ["no_mismatch", "recalibrate"] if exact else ["recalibrate", "no_mismatch"]
        return {"verdict": verdicts, "effects": [], "truth": [], "drivers": {}, "params": {}, "where": None}
    if tier == "novel":
        (name, _, drivers), unknown = parts[0], {"unknown": list(parts[0][2])}
        verdicts = ["unexplained", "missing_physics"]
        return {"verdict": verdicts, "effects": [["unknown"]], "truth": [name], "drivers": unknown} | {
            "params": {},
            "where": None,
        }
    out: dict = {
        "verdict": ["missing_physics"],
        "effects": [],
        "truth": [],
        "drivers": {},
        "params": {},
        "where": where,
    }
    for (name, values, drivers), factor in zip(parts, factors, strict=True):
        effect = bench.effects[name]
        names, known = accepted(bench.sheet, bench.component, name, factor * values, bench.base, noise)
        out["effects"].append([*names, *(a for a in effect.also if a not in names)])
        out["truth"].append(name)
        out["drivers"] |= {**known, name: sorted({*drivers, *known.get(name, [])})}
        grown = factor / float(np.std(effect.values))
        for what, (value, unit, grows) in effect.sizes.items():
            out["params"][f"{name}.{what}"] = {"value": abs(value) * (grown if grows else 1.0), "unit": unit}
    return out


def generate(
    out: Path, seed: int, cases: int, tiers: list[str] | None = None, effects: list[str] | None = None
) -> None:
    """out/cases/<id>/, out/answers/<id>.json and out/answers.sha256, as the other generators write them."""
    rng = np.random.default_rng([seed, 333])
    names = list(MACHINES)
    share = np.array([MACHINES[m][0] for m in names])
    keys = {}
    for number, tier in enumerate(in_shares(rng, TIERS, cases, tiers or list(TIERS))):
        while True:
            machine = str(rng.choice(names, p=share / share.sum()))
            try:
                sheet, case = one_case(seed, number, tier, machine, effects)
                break
            except RuntimeError:  # this machine cannot show it: another one
                continue
        name = hashlib.sha256(f"third {seed} {number}".encode()).hexdigest()[:10]
        folder.write(out / "cases" / name, sheet)
        keys[name] = {"case": name, **case}
    seal(out, keys)
