"""The measuring chain: noise, display, outliers, empty cells, lost and repeated rows, and writing the folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from .case import Array, Bench, Column

LADDER = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0])


def correlated(rng: np.random.Generator, n: int, rms: float) -> Array:
    """White noise with a small part that remembers a few readings."""
    share = rng.uniform(0.0, 0.25)
    keep = np.exp(-1.0 / rng.uniform(2, 8))
    red = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], rng.normal(0, 1, n))
    return rms * (np.sqrt(1 - share) * rng.normal(0, 1, n) + np.sqrt(share) * red)


def fit_step(step: float, noise: float) -> float:
    """The display's step, or the next finer one that does not hide the noise."""
    finer = LADDER[noise >= 1.6 * LADDER]
    return min(step, float(finer[-1])) if finer.size else 0.01


def display(values: Array, step: float) -> Array:
    return np.round(np.round(values / step) * step, 9)


def outliers(rng: np.random.Generator, n: int, noise: float, share: float) -> Array:
    """Rare wild readings, 6 to 25 times the noise."""
    out = np.zeros(n)
    k = rng.binomial(n, share)
    where = rng.choice(n, size=k, replace=False)
    out[where] = noise * rng.uniform(6, 25, k) * rng.choice([-1, 1], k)
    return out


def shown_column(rng: np.random.Generator, column: Column) -> Array:
    values = column.values + (rng.normal(0, 1, column.values.size) * column.noise if column.noise else 0.0)
    return display(values, column.step) if column.step else np.round(values, column.decimals)


def lose(
    rng: np.random.Generator, columns: dict[str, Array], sensors: list[str], used: set[str], errors: list[str]
) -> None:
    """Empty cells here and there; sometimes a sensor that nothing depends on dies or sticks."""
    for name in sensors + errors:
        if rng.random() < (0.3 if name in sensors else 0.35):
            gone = rng.random(columns[name].size) < rng.uniform(0.002, 0.012)
            columns[name][gone] = np.nan
    idle = [s for s in sensors if s not in used]
    if idle and rng.random() < 0.3:
        name, n = str(rng.choice(idle)), columns[idle[0]].size
        start = int(rng.uniform(0, 0.6) * n)
        if rng.random() < 0.5:
            columns[name][start:] = np.nan
        else:
            columns[name][start:] = columns[name][start]


def order(rng: np.random.Generator, bench: Bench) -> Array:
    """Indices of the rows as they are stored: some lost, some stored twice."""
    n = bench.rows
    keep = np.arange(n)
    if bench.lossy and rng.random() < 0.5:
        keep = keep[rng.random(n) > rng.uniform(0.001, 0.006)]
    if bench.lossy and rng.random() < 0.4:
        keep = np.sort(np.concatenate([keep, keep[rng.random(keep.size) < rng.uniform(0.0005, 0.005)]]))
    return keep


def text(values: Array, decimals: int) -> list[str]:
    if decimals == 0:
        return ["" if v != v else str(int(v)) for v in values.tolist()]
    return ["" if v != v else repr(v) for v in np.round(values, decimals).tolist()]


def write_table(path: Path, names: list[str], cells: list[list[str]]) -> None:
    lines = [",".join(names)]
    lines.extend(",".join(row) for row in zip(*cells, strict=True))
    path.write_text("\n".join(lines) + "\n")


def _yaml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_yaml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_yaml(v) for v in value) + "]"
    if isinstance(value, str):
        return f"'{value}'" if any(c in value for c in ",:#{}[]") else value
    return repr(value)


def write_manifest(path: Path, bench: Bench, columns: dict[str, dict]) -> None:
    title = f"'{bench.title}'" if ":" in bench.title else bench.title
    lines = ["recording: 1", f"title: {title}", f"machine: {bench.machine}", "tables:", "- recording.csv"]
    if bench.constants:
        lines.append("constants:")
        lines.extend(f"  {k}: {_yaml(v)}" for k, v in bench.constants.items())
    lines.append("columns:")
    lines.extend(f"  {k}: {_yaml(v)}" for k, v in columns.items())
    path.write_text("\n".join(lines) + "\n")
