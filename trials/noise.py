"""Noise as instruments have it, with nothing or one textbook effect in it: is the one quiet, the other named?

python -m trials.noise --seed 7 [--repeats 1] [--json FILE]

Three machines (a positioning axis without a direction column, a spindle at changing speed, a trace of a drive's force),
ten kinds of noise, and of each a recording with nothing missing and one with an effect of 3 times the noise. Formulas
of numpy alone; nothing here is shared with the diagnosis.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray
ALARM, SURE, TIMES = 0.5, 0.8, 3.0


def first_order(rng: np.random.Generator, n: int, keep: float) -> Array:
    """AR(1) noise; keep 1: a random walk."""
    out, pushes = np.zeros(n), rng.standard_normal(n)
    for i in range(1, n):
        out[i] = keep * out[i - 1] + pushes[i]
    return out


def pink(rng: np.random.Generator, n: int) -> Array:
    """Power that falls with the frequency."""
    spectrum = np.fft.rfft(rng.standard_normal(n)) / np.sqrt(np.maximum(np.arange(n // 2 + 1), 1))
    return np.fft.irfft(spectrum, n)


def jumps(rng: np.random.Generator, n: int) -> Array:
    """A gauge that jumps four times."""
    out = 0.3 * rng.standard_normal(n)
    for at in rng.choice(n, 4, replace=False):
        out[at:] += rng.normal(0, 1.5)
    return out


def hum(rng: np.random.Generator, n: int) -> Array:
    """Mains hum, folded down by slow sampling."""
    beat = rng.uniform(0.02, 0.4) * np.arange(n) + rng.uniform()
    return np.sin(2 * np.pi * beat) + 0.3 * rng.standard_normal(n)


def uneven(rng: np.random.Generator, n: int) -> Array:
    """Noise whose size drifts by a factor of several."""
    return rng.standard_normal(n) * np.exp(0.06 * np.cumsum(rng.standard_normal(n)).clip(-25, 25))


KINDS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "white": lambda rng, n: rng.standard_normal(n),
    "AR(1) 0.9": lambda rng, n: first_order(rng, n, 0.9),
    "AR(1) 0.99": lambda rng, n: first_order(rng, n, 0.99),
    "AR(1) 0.999": lambda rng, n: first_order(rng, n, 0.999),
    "random walk": lambda rng, n: first_order(rng, n, 1.0),
    "1/f": pink,
    "Student t, 2 dof": lambda rng, n: rng.standard_t(2, n),
    "jumps": jumps,
    "hum": hum,
    "uneven": uneven,
}
COARSE = "read in steps"  # white noise of a third of the display's step


class Machine(NamedTuple):
    """Columns and their roles, the simulated value, and an effect of unit rms with the names that are right for it."""

    columns: dict[str, Array]
    roles: dict[str, dict[str, str]]
    component: str
    simulated: Array
    effect: Array
    names: tuple[str, ...]


def late(t: Array, u: Array, tau: float) -> Array:
    """First-order lag of u."""
    out = u.copy()
    for i in range(1, u.size):
        out[i] = out[i - 1] + (u[i] - out[i - 1]) * (1 - np.exp(-(t[i] - t[i - 1]) / tau))
    return out


def read(rng: np.random.Generator, u: Array) -> Array:
    """A sensor's reading."""
    return np.round(u + 0.03 * rng.standard_normal(u.size), 2)


def axis(rng: np.random.Generator) -> Machine:
    """Bidirectional positioning of a linear axis; only positions tell where it comes from. Missing: lost motion."""
    places, passes = np.linspace(0, rng.uniform(200, 900), 41), 6
    x = np.tile(np.r_[places, places[::-1]], passes)
    side = np.r_[1.0, np.tile(np.repeat([1.0, -1.0], places.size), passes)[:-1]]
    run = np.repeat(np.arange(1, passes + 1), 2 * places.size)
    t = 6.0 * np.arange(x.size) + 600.0 * (run - 1)
    scale = 20 + 4 * (1 - np.exp(-t / 4000))
    room = 20 + 0.8 * np.sin(2 * np.pi * t / 9000)
    columns = {"run": run, "t": t, "x": x, "T_scale": read(rng, scale), "T_room": read(rng, room)}
    roles = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "T_scale": {"role": "temperature", "unit": "degC", "location": "scale"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room"},
    }
    simulated = 0.01 * x * (scale - 20) + 0.02 * x
    return Machine(columns, roles, "EXX", simulated, side, ("backlash", "friction_hysteresis"))


def spindle(rng: np.random.Generator) -> Machine:
    """A spindle at changing speed. Missing: growth by centrifugal force."""
    n, t = 900, 60.0 * np.arange(900)
    rpm = np.repeat(rng.choice([0.0, 2000, 5000, 8000, 12000], n // 60), 60)
    heat = (rpm / 10000) ** 1.5
    bearing = 15 * late(t, heat, 900.0)
    room = 20 + 1.5 * np.sin(2 * np.pi * t / 30000 + rng.uniform(0, 6))
    column = late(t, room, 7200.0) + 0.2 * late(t, bearing, 5400.0)
    columns = {"t": t, "rpm": rpm, "T_bearing": read(rng, room + bearing), "T_column": read(rng, column)}
    columns["T_room"] = read(rng, room)
    roles = {"t": {"role": "time", "unit": "s"}, "rpm": {"role": "spindle_speed", "unit": "rpm"}}
    for name, place in (("T_bearing", "spindle bearing"), ("T_column", "column"), ("T_room", "room")):
        roles[name] = {"role": "temperature", "unit": "degC", "location": place}
    simulated = 1.5 * bearing + late(t, room, 7200.0) - 20
    return Machine(columns, roles, "E_Z", simulated, (rpm / 10000) ** 2, ("centrifugal_growth",))


def trace(rng: np.random.Generator) -> Machine:
    """The force of a drive under way. Missing: dry friction."""
    t = np.arange(5000) / 250.0
    x = 150 + 100 * np.sin(2 * np.pi * rng.uniform(0.08, 0.15) * t) + 30 * np.sin(2 * np.pi * 0.37 * t)
    v = np.gradient(x, t)
    a = np.gradient(v, t)
    roles = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
        "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
    }
    names = ("coulomb_friction", "stribeck_friction")
    return Machine({"t": t, "x": x, "v": v, "a": a}, roles, "F_X", 0.04 * a + 0.3 * v, np.sign(v), names)


MACHINES = {"axis": axis, "spindle": spindle, "trace": trace}


def case(seed: int, machine: str, kind: str, hidden: bool) -> tuple[Any, tuple[str, ...]]:
    """A recording, and the names that are right for what is missing from it: none where nothing is."""
    import pandas as pd

    from errpipe.domain.recording import Manifest, Recording

    where = (list(MACHINES).index(machine), [*KINDS, COARSE].index(kind), int(hidden))
    rng = np.random.default_rng([seed, *where])
    made = MACHINES[machine](rng)
    noise = KINDS.get(kind, KINDS["white"])(rng, made.simulated.size)
    size = 0.15 * float(np.std(made.simulated))
    noise = (noise - noise.mean()) / noise.std() * size
    effect = TIMES * size * made.effect / np.std(made.effect) if hidden else 0.0
    recorded = rng.uniform(0.92, 1.08) * made.simulated + effect + noise
    if kind == COARSE:
        recorded = np.round(recorded / (3 * size)) * 3 * size
    unit = "N" if made.component.startswith("F") else "um"
    roles = made.roles | {
        "E": {"role": "error", "component": made.component, "unit": unit},
        "S": {"role": "simulated", "component": made.component, "unit": unit},
    }
    frame = pd.DataFrame(made.columns | {"E": recorded, "S": made.simulated})
    if "run" in frame:
        frame["run"] = frame["run"].astype(str)
    manifest = Manifest.model_validate(
        {"recording": 1, "title": "noise", "tables": ["recording.csv"], "columns": roles}
    )
    return Recording(manifest, frame), made.names if hidden else ()


def said(recording: Any) -> list[tuple[str, float]]:
    """What the diagnosis names, with its confidence."""
    from errpipe.diagnosis import diagnose

    (response,) = diagnose(recording)[0].responses
    return [(f.effect, f.confidence) for f in response.findings if f.effect != "recalibration"]


def judged(names: tuple[str, ...], findings: list[tuple[str, float]]) -> dict[str, bool]:
    """Is it right, and is a wrong name sure?"""
    wrong = [c for effect, c in findings if effect not in (*names, "unknown")]
    right = bool(findings) and findings[0][0] in names if names else not any(c >= ALARM for _, c in findings)
    return {"right": right, "sure_and_wrong": any(c >= SURE for c in wrong)}


def main() -> None:
    parser = argparse.ArgumentParser(description="Blind trials in real kinds of noise.")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    rows = []
    for k in range(a.repeats):
        for machine in MACHINES:
            for kind in (*KINDS, COARSE):
                for hidden in (False, True):
                    recording, names = case(a.seed + 1000 * k, machine, kind, hidden)
                    message = said(recording)
                    row = {"machine": machine, "noise": kind, "missing": bool(names), "said": message}
                    rows.append(row | judged(names, message))
                    what = ", ".join(f"{effect} {c:.2f}" for effect, c in message) or "nothing"
                    print(f"{machine}, {kind}, {'one effect' if names else 'null'}: {what}", flush=True)
    nulls, effects = [r for r in rows if not r["missing"]], [r for r in rows if r["missing"]]
    print(f"nulls quiet {sum(r['right'] for r in nulls)} of {len(nulls)}")
    print(f"effects named {sum(r['right'] for r in effects)} of {len(effects)}")
    print(f"sure and wrong {sum(r['sure_and_wrong'] for r in rows)} of {len(rows)}")
    if a.json:
        a.json.write_text(json.dumps({"seed": a.seed, "cases": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
