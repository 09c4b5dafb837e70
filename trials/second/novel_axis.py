"""Mechanisms outside the vocabulary for one axis or two: positioning, circles, traces."""

from __future__ import annotations

from typing import Any

import numpy as np

from .climate import Climate, sign
from .contact import play, since_reversal
from .heat import lagged
from .scene import Maker, Part

Rng = np.random.Generator


def other(name: str, values: np.ndarray, acting: np.ndarray | None = None) -> Part:
    """A mechanism without an id, named for the reader of the key only."""
    return Part("unknown", values, [], {}, (), acting, None, {}, f"outside the vocabulary: {name}")


def positioning_novel(
    plan: Any, climate: Climate, t: np.ndarray, x: np.ndarray, side: np.ndarray, runs: np.ndarray
) -> dict[str, Maker]:
    u = x / plan.travel

    def pretension(rng: Rng) -> Part:
        """A screw stretched at assembly grows only once the stretch is used up."""
        warm = climate.rise("T_nut")
        over = np.maximum(lagged(climate.clock, warm, 400) - rng.uniform(0.35, 0.6) * warm.max(), 0)
        return other("screw that has lost its pretension", sign(rng) * 11.5 * climate.at(over) * u)

    def joint(rng: Rng) -> Part:
        """A bolted joint that slips: the bed's warm-up and cool-down differ however slow they are."""
        warm = climate.rise("T_bed")
        slipped = play(warm, rng.uniform(0.4, 0.8) * np.ptp(warm))
        return other("joint that slips with temperature", sign(rng) * 8 * climate.at(warm - slipped))

    def relube(rng: Rng) -> Part:
        period, decay = rng.uniform(900, 2600), rng.uniform(200, 700)
        return other("lubrication pulses", sign(rng) * 5 * np.exp(-np.mod(t + rng.uniform(0, period), period) / decay))

    def cover(rng: Rng) -> Part:
        folds = rng.integers(4, 8)
        ramp = np.mod(u * folds + rng.uniform(0, 1), 1)
        return other("folds of a telescopic cover", sign(rng) * 5 * side * (ramp - 0.5))

    def seam(rng: Rng) -> Part:
        return other("joint between two lengths of scale", sign(rng) * 6 * np.tanh((u - rng.uniform(0.3, 0.7)) / 0.01))

    def warm_pitch(rng: Rng) -> Part:
        beat = np.sin(2 * np.pi * x / (plan.travel / rng.uniform(2.2, 4.5)) + rng.uniform(0, 6))
        return other("buckling of a warm screw", sign(rng) * 2 * beat * climate.at(climate.rise("T_nut")))

    def settling(rng: Rng) -> Part:
        value = np.zeros(len(t))
        for r in np.unique(runs):
            rows = runs == r
            value[rows] = np.exp(-(t[rows] - t[rows][0]) / rng.uniform(80, 250))
        return other("column settling after the start of a run", sign(rng) * 5 * value)

    def clamp(rng: Rng) -> Part:
        jumps = np.sort(rng.uniform(0.1, 0.95, 4)) * t[-1]
        return other(
            "reflector that slips on its clamp",
            np.cumsum(np.r_[0, rng.choice([-1, 1], 4) * rng.uniform(3, 8, 4)])[np.searchsorted(jumps, t)],
        )

    def neighbour(rng: Rng) -> Part:
        press = np.mod(t + rng.uniform(0, 900), rng.uniform(300, 900)) < rng.uniform(60, 160)
        return other("press next door", sign(rng) * 5 * press)

    return {
        "pretension": pretension,
        "joint": joint,
        "relube": relube,
        "cover": cover,
        "seam": seam,
        "warm_pitch": warm_pitch,
        "settling": settling,
        "clamp": clamp,
        "neighbour": neighbour,
    }


def circular_novel(path: Any) -> dict[str, Maker]:
    angle = np.arctan2(path.y, path.x)

    def cable(rng: Rng) -> Part:
        """The cable carrier pulls on one quarter and only one way round."""
        near = np.exp(-(((np.mod(angle - rng.uniform(-3, 3) + np.pi, 2 * np.pi) - np.pi) / 0.35) ** 2))
        return other("cable carrier", sign(rng) * 5 * near * (path.spin == sign(rng)))

    def hum(rng: Rng) -> Part:
        f = rng.uniform(1.5, 9)
        phase = {r: rng.uniform(0, 6.28) for r in np.unique(path.runs)}
        return other("hum of a pump", 2 * np.sin(2 * np.pi * f * path.t + np.array([phase[r] for r in path.runs])))

    def ball(rng: Rng) -> Part:
        n = int(rng.choice([5, 7, 9]))
        return other("ball that is not round", 2 * np.sin(n * angle + rng.uniform(0, 6)))

    def creep(rng: Rng) -> Part:
        value = np.zeros(len(path.t))
        for r in np.unique(path.runs):
            rows = path.runs == r
            now = path.t[rows] - path.t[rows][0]
            value[rows] = np.exp(-now / (rng.uniform(0.1, 0.3) * now[-1]))
        return other("centre cup that settles", sign(rng) * 4 * value)

    def slip(rng: Rng) -> Part:
        runs = list(dict.fromkeys(path.runs.tolist()))
        value = {r: rng.normal() for r in runs}
        at = rng.uniform(-2, 2)
        return other(
            "cup that slips in a run",
            3 * np.array([value[r] for r in path.runs]) * (np.mod(angle - at, 2 * np.pi) > np.pi),
        )

    def resonance(rng: Rng) -> Part:
        after = since_reversal(np.sign(path.vx), path.t, path.runs)
        ring = np.where(
            np.isfinite(after),
            np.exp(-np.minimum(after, 99) / 0.5) * np.sin(2 * np.pi * rng.uniform(3, 8) * np.minimum(after, 99)),
            0,
        )
        return other("column that rings on after a reversal", 4 * ring, np.isfinite(after) & (after < 1.0))

    def stick(rng: Rng) -> Part:
        low = path.feed == path.feed.min()
        saw = np.mod(path.x / rng.uniform(2, 6), 1) - 0.5
        return other("stick-slip at the lowest feed", 3 * saw * low * path.x / path.radius, low)

    return {
        "cable": cable,
        "hum": hum,
        "ball": ball,
        "creep": creep,
        "slip": slip,
        "resonance": resonance,
        "stick": stick,
    }


def trace_novel(path: Any, force: bool) -> dict[str, Maker]:
    size = 8.0 if force else 2.0

    def balls(rng: Rng) -> Part:
        f = rng.uniform(2, 15)
        return other("vibration of a neighbour", size * np.sin(2 * np.pi * f * path.t + rng.uniform(0, 6)))

    def chain(rng: Rng) -> Part:
        s = path.x - np.quantile(path.x, rng.uniform(0.5, 0.75))
        return other("cable carrier that jams beyond one place", sign(rng) * size * np.expm1(np.clip(s, 0, 150) / 60))

    def wiper(rng: Rng) -> Part:
        step = rng.uniform(4, 9)
        return other("teeth of a wiper, one way only", size * (np.mod(path.x / step, 1) ** 3) * (path.v > 0))

    def ring(rng: Rng) -> Part:
        side = np.where(np.abs(path.v) > 0.05, np.sign(path.v), 0)
        after = np.minimum(since_reversal(side, path.t, path.runs), 99)
        f = rng.uniform(4, 12)
        ok = np.isfinite(after) & (after > 0) & (after < 50)
        value = np.where(ok, np.exp(-np.maximum(after, 0) / 0.3) * np.sin(2 * np.pi * f * np.maximum(after, 0)), 0)
        return other("ringing after a reversal", size * 1.5 * value, ok & (after < 0.6))

    def windage(rng: Rng) -> Part:
        return other("chip conveyor belt pulled along", sign(rng) * size * (path.v / np.max(np.abs(path.v))) ** 2 * 3)

    def fading(rng: Rng) -> Part:
        now = np.zeros(len(path.t))
        for r in np.unique(path.runs):
            now[path.runs == r] = path.t[path.runs == r] - path.t[path.runs == r][0]
        tau = rng.uniform(1.0, 4.0)
        return other("brake that drags after release", sign(rng) * size * 2 * np.exp(-now / tau))

    def limit(rng: Rng) -> Part:
        top = rng.uniform(0.3, 0.6) * np.max(np.abs(path.a))
        over = np.sign(path.a) * np.maximum(np.abs(path.a) - top, 0)
        return other("drive at its current limit", size * 4 * over / np.max(np.abs(over)), np.abs(path.a) > top)

    def steps(rng: Rng) -> Part:
        jumps = np.sort(rng.uniform(0.05, 0.95, 5)) * path.t[-1]
        level = np.r_[0, rng.normal(0, 1, 5)]
        return other("amplifier whose zero jumps", size * level[np.searchsorted(jumps, path.t)])

    return {
        "balls": balls,
        "chain": chain,
        "wiper": wiper,
        "ring": ring,
        "windage": windage,
        "fading": fading,
        "limit": limit,
        "steps": steps,
    }
