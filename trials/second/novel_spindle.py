"""Mechanisms outside the vocabulary of a spindle in its room."""

from __future__ import annotations

from typing import Any

import numpy as np

from .climate import Climate, sign
from .contact import play
from .heat import lagged
from .novel_axis import other
from .scene import Column, Maker, Part

Rng = np.random.Generator


def spindle_novel(rig: Any, climate: Climate, columns: dict[str, Column]) -> dict[str, Maker]:
    now = rig.rpm[np.clip(np.round(rig.t / 30.0).astype(int), 0, len(rig.rpm) - 1)]

    def doors(rng: Rng) -> Part:
        """The hall's doors: a cold draught whenever they stand open; nobody logs them."""
        times = np.sort(rng.uniform(0, rig.t[-1], int(rng.integers(6, 14))))
        open_ = np.zeros(len(rig.clock))
        for a in times:
            open_[(rig.clock >= a) & (rig.clock < a + rng.uniform(200, 1200))] = rng.uniform(0.4, 1)
        draught = lagged(rig.clock, lagged(rig.clock, open_, rng.uniform(120, 500)), rng.uniform(60, 300))
        return other("doors", sign(rng) * 10 * climate.at(draught))

    def preload(rng: Rng) -> Part:
        """A bearing ring seats anew at every start, nobody knows where."""
        starts = np.concatenate([[0], np.cumsum(np.diff((now > 0).astype(int)) == 1)])
        return other("bearing ring that seats anew at every start", 5 * rng.normal(0, 1, starts.max() + 1)[starts])

    def resonance(rng: Rng) -> Part:
        """One speed at which the housing swings out."""
        levels = np.unique(now[now > 0])
        at = float(rng.choice(levels)) if len(levels) else 1.0
        return other("resonance at one speed", sign(rng) * 8 / (1 + ((now - at) / (0.04 * rig.top)) ** 2), now == at)

    def chiller(rng: Rng) -> Part:
        """An oil cooler with a thermostat: it switches on its own."""
        x, on, out = 0.0, False, np.empty(len(rig.clock))
        heat, cold = rng.uniform(1, 3) / 1800, rng.uniform(3, 6) / 1800
        for i in range(len(out)):
            on = x > 1 or (on and x > -1)
            x += 30.0 * ((-cold if on else heat) + 1e-4 * rng.normal())
            out[i] = x
        return other("thermostat of an oil cooler", sign(rng) * 3 * climate.at(lagged(rig.clock, out, 150)))

    def pressure(rng: Rng) -> Part:
        """Clamping by a hydraulic unit that sags and is pumped up (its pressure may be in the recording)."""
        if "p_hyd" not in columns:
            return None
        p = columns["p_hyd"].values
        return other("hydraulic counterbalance", sign(rng) * 5 * (p - p[0]) / np.ptp(p))

    def sun(rng: Rng) -> Part:
        start = rng.uniform(0, 0.7) * rig.t[rig.runs == "1"][-1]
        patch = ((rig.clock - start) % 86400 < rng.uniform(4000, 9000)).astype(float) * (rig.clock >= start)
        return other("patch of sunlight", sign(rng) * 8 * climate.at(lagged(rig.clock, patch, rng.uniform(900, 2500))))

    def joint(rng: Rng) -> Part:
        warm = climate.rise("T_housing")
        return other(
            "joint that slips with temperature", sign(rng) * 2 * climate.at(warm - play(warm, 0.5 * np.ptp(warm)))
        )

    def lube(rng: Rng) -> Part:
        period = rng.uniform(1500, 5000)
        pulse = np.exp(-np.mod(rig.t + rng.uniform(0, period), period) / rng.uniform(200, 700))
        return other("lubrication pulses", sign(rng) * 5 * pulse * (1 if rng.random() < 0.5 else now > 0))

    def crane(rng: Rng) -> Part:
        jumps = np.sort(rng.uniform(0, rig.t[-1], 6))
        level = np.r_[0, rng.normal(0, 1, 6)]
        return other("crane that leaves its load beside the machine", 6 * level[np.searchsorted(jumps, rig.t)])

    def saturation(rng: Rng) -> Part:
        """Preload grows with the temperature difference of the rings and lets go past a limit."""
        d = climate.rise("T_bearing") - climate.rise("T_housing")
        limit = rng.uniform(0.4, 0.7) * d.max()
        return other("preload that lets go", sign(rng) * 8 * climate.at(np.where(d > limit, 0, d)) / max(limit, 1e-6))

    return {
        "doors": doors,
        "preload": preload,
        "resonance": resonance,
        "chiller": chiller,
        "pressure": pressure,
        "sun": sun,
        "joint": joint,
        "lube": lube,
        "crane": crane,
        "saturation": saturation,
    }
