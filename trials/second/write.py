"""One case as files: recording.yaml, recording.csv, answer.json, in the layout of the public sample."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from .key import Case
from .noise import empty_cells, row_order
from .scene import Scene, shown

Rng = np.random.Generator


def write_case(folder: Path, name: str, tier: str, scene: Scene, cases: list[Case], rng: Rng) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.yaml").write_text(manifest(scene, cases))
    table(scene, cases, rng).to_csv(folder / "recording.csv", index=False)
    key = {"case": name, "tier": tier, "protocol": scene.protocol, "responses": {c.component: c.key for c in cases}}
    (folder / "answer.json").write_text(json.dumps(key, indent=1) + "\n")


def manifest(scene: Scene, cases: list[Case]) -> str:
    lines = ["recording: 1", f"title: {scene.title}", f"machine: {scene.machine}", "tables:", "- recording.csv"]
    if scene.constants:
        lines += ["constants:"] + [f"  {k}: {v}" for k, v in scene.constants.items()]
    lines += ["columns:", "  run: {role: run}"]
    lines += [f"  {k}: {flow(c.spec)}" for k, c in scene.columns.items()]
    for c in cases:
        for suffix, role in (("", "error"), ("_sim", "simulated")):
            lines.append(
                f"  {c.component}{suffix}: " + flow({"role": role, "component": c.component, "unit": c.key["unit"]})
            )
    return "\n".join(lines) + "\n"


def flow(spec: dict) -> str:
    def text(v: object) -> str:
        s = str(v)
        return f"'{s}'" if "," in s and not s.startswith("'") else s

    return "{" + ", ".join(f"{k}: {text(v)}" for k, v in spec.items()) + "}"


def table(scene: Scene, cases: list[Case], rng: Rng) -> pd.DataFrame:
    """The log: displayed values, empty cells, missing and repeated rows, sometimes a dead sensor."""
    faulty = {k: v for c in cases for k, v in c.cells.items()}
    data: dict[str, np.ndarray] = {"run": scene.runs}
    for name, column in scene.columns.items():
        if name in faulty:
            column.values = faulty[name]
        values = np.round(shown(column), 6)
        whole = column.step == 1 and column.spec["role"] in ("direction", "coolant")
        data[name] = values.astype(int) if whole else values
    for c in cases:
        data[c.component] = np.where(scene.measured(), c.recorded, np.nan)
        data[f"{c.component}_sim"] = c.simulated
    frame = pd.DataFrame(data)
    _holes(frame, scene, cases, rng)
    return frame.iloc[row_order(rng, len(frame))]


def _holes(frame: pd.DataFrame, scene: Scene, cases: list[Case], rng: Rng) -> None:
    sensors = [k for k, c in scene.columns.items() if c.spec["role"] == "temperature"]
    used = {d for c in cases for names in c.key["drivers"].values() for d in names}
    for name in [*sensors, *(c.component for c in cases)]:
        frame.loc[empty_cells(rng, len(frame)), name] = np.nan
    spare = [s for s in sensors if s not in used and not any(s in c.needs for c in cases)]
    if spare and len(sensors) > 3 and rng.random() < 0.12:
        frame.loc[frame.index >= int(rng.uniform(0.1, 0.8) * len(frame)), str(rng.choice(spare))] = np.nan
