"""Mechanisms outside the vocabulary of the work space and of a cutting series."""

from __future__ import annotations

from typing import Any

import numpy as np

from .climate import Climate, sign
from .heat import lagged
from .novel_axis import other
from .scene import Maker, Part

Rng = np.random.Generator


def grid_novel(vol: Any, climate: Climate, me: str) -> dict[str, Maker]:
    u = {a: 2 * vol.place(a) / vol.size[a] - 1 for a in "XYZ"}
    others = [a for a in "XYZ" if a != me]

    def seam(rng: Rng) -> Part:
        a = str(rng.choice(others))
        return other("step between two bed sections", sign(rng) * 5 * np.tanh((u[a] - rng.uniform(-0.4, 0.4)) / 0.05))

    def setup(rng: Rng) -> Part:
        value = {r: rng.normal(0, 1) for r in np.unique(vol.runs)}
        return other(
            "reflector set up anew in every run",
            6 * np.array([value[r] for r in vol.runs]) * u[str(rng.choice(others))],
        )

    def saddle(rng: Rng) -> Part:
        return other("plate that warps", sign(rng) * 8 * (u["X"] ** 2 - 0.4) * (u["Y"] ** 2 - 0.4) * 3)

    def arch(rng: Rng) -> Part:
        a = str(rng.choice(others))
        return other(
            "arch that grows with bed temperature",
            sign(rng) * 3 * (1 - u[a] ** 2 - 0.5) * climate.at(climate.rise("T_bed")),
        )

    def foundation(rng: Rng) -> Part:
        x = vol.load / max(vol.load.max(), 1.0)
        return other(
            "foundation that tips past a load",
            sign(rng) * 10 * np.maximum(x - rng.uniform(0.2, 0.5), 0) * np.sign(u["X"]),
        )

    def truck(rng: Rng) -> Part:
        period = rng.uniform(200, 900)
        return other("lorries", sign(rng) * 5 * np.exp(-np.mod(vol.t + rng.uniform(0, period), period) / 50))

    def ripple(rng: Rng) -> Part:
        a = str(rng.choice(others))
        return other(
            "wave of the guideway's bolts",
            4 * np.sin(2 * np.pi * vol.place(a) / rng.uniform(70, 110) + rng.uniform(0, 6)),
        )

    return {
        "seam": seam,
        "setup": setup,
        "saddle": saddle,
        "arch": arch,
        "foundation": foundation,
        "truck": truck,
        "ripple": ripple,
    }


def cutting_novel(job: Any, climate: Climate) -> dict[str, Maker]:
    def insert(rng: Rng) -> Part:
        level = {r: rng.normal() for r in np.unique(job.runs)}
        return other("seat of each insert", 5 * np.array([level[r] for r in job.runs]))

    def whip(rng: Rng) -> Part:
        at = float(rng.choice(np.unique(job.rpm)))
        return other(
            "bar that whips at one speed", sign(rng) * 6 / (1 + ((job.rpm - at) / 150) ** 2), np.abs(job.rpm - at) < 1
        )

    def edge(rng: Rng) -> Part:
        """Built-up edge in a window of speeds: grows over some parts and breaks off."""
        level, out = 0.0, np.zeros(job.n)
        for i in range(job.n):
            level = level + rng.uniform(0.02, 0.2) if rng.random() < 0.96 else 0.0
            out[i] = level
        return other("built-up edge that breaks off", sign(rng) * 4 * out)

    def touch(rng: Rng) -> Part:
        jumps = np.sort(rng.choice(job.n, 8, replace=False))
        level = np.r_[0, np.cumsum(rng.normal(0, 1, 8))]
        return other("operator's own corrections", 4 * level[np.searchsorted(jumps, np.arange(job.n))])

    def doors(rng: Rng) -> Part:
        open_ = np.zeros(len(job.clock))
        for a in rng.uniform(0, job.t[-1], int(rng.integers(10, 18))):
            open_[(job.clock >= a) & (job.clock < a + rng.uniform(600, 2500))] = 1
        return other("doors", sign(rng) * 8 * climate.at(lagged(job.clock, open_, rng.uniform(200, 700))))

    def batch(rng: Rng) -> Part:
        length = int(rng.integers(12, 30))
        return other("batches of blanks", 5 * rng.normal(0, 1, job.n // length + 1)[np.arange(job.n) // length])

    def first(rng: Rng) -> Part:
        rest = np.diff(job.t, prepend=-5000.0) > 500
        since = np.arange(job.n) - np.maximum.accumulate(np.where(rest, np.arange(job.n), 0))
        return other("first parts after a break", sign(rng) * 6 * np.exp(-since / rng.uniform(1.5, 4)), since < 6)

    return {
        "insert": insert,
        "whip": whip,
        "edge": edge,
        "touch": touch,
        "doors": doors,
        "batch": batch,
        "first": first,
    }
