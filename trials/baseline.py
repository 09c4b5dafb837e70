"""Baseline: a greedy regression over the textbook forms on the same cases.

    python -m trials.baseline OUT_DIR        # OUT_DIR as `generate` wrote it

It scales the simulation, then adds the best form as long as that pays. It has no reversal spikes, faults or clocks.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from .first.case import Array, Bench, Column
from .first.lookalikes import Target, forms, possible
from .score import markdown, score, wrong_ones

PROTOCOL_BY_TITLE = {
    "Circular": "circular test",
    "bidirectional": "linear positioning",
    "Spindle": "spindle drift",
    "under way": "feedback trace",
    "grid": "volumetric grid",
    "Boring": "cutting series",
}
PAYS, MIN_GAIN, SURE_GAIN = 12.0, 0.07, 0.3  # log evidence at a quarter of the rows; shares of the rest


def _filled(values: Array) -> Array:
    seen = np.flatnonzero(~np.isnan(values))
    if not seen.size:
        return np.zeros(values.size)
    last = np.maximum.accumulate(np.where(np.isnan(values), seen[0], np.arange(values.size)))
    return values[last]


def load(folder: Path) -> tuple[Bench, dict[str, tuple[Array, Array]]]:
    """The recording as a bench without truth, and (error, simulated) by component."""
    manifest = YAML(typ="safe").load((folder / "recording.yaml").read_text())
    with open(folder / "recording.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    columns, responses = {}, {}
    for name, spec in manifest["columns"].items():
        if spec["role"] in ("run", "ignore"):
            continue
        values = np.array([float(r[name]) if r[name] else np.nan for r in rows])
        if spec["role"] in ("error", "simulated"):
            pair = responses.setdefault(spec["component"], [None, None])
            pair[spec["role"] == "simulated"] = values
        else:
            columns[name] = Column(dict(spec), _filled(values))
    title = manifest["title"]
    protocol = next(v for k, v in PROTOCOL_BY_TITLE.items() if k in title)
    measured = ~np.isnan(next(iter(responses.values()))[0])
    bench = Bench(protocol, title, "", manifest.get("constants") or {}, columns, [r["run"] for r in rows], measured, {})
    return bench, {k: (v[0], v[1]) for k, v in responses.items()}


def diagnose(folder: Path) -> dict[str, Any]:
    """A document in the shape of a diagnosis."""
    bench, pairs = load(folder)
    library = list(forms(bench))
    return {
        "diagnosis": 1,
        "recording": bench.title,
        "responses": [_response(bench, c, error, simulated, library) for c, (error, simulated) in pairs.items()],
    }


def _response(bench: Bench, component: str, error: Array, simulated: Array, library) -> dict[str, Any]:
    mismatch = error - simulated
    good = ~np.isnan(error)
    middle = np.median(mismatch[good])
    good &= np.abs(mismatch - middle) < 8 * 1.4826 * np.median(np.abs(mismatch[good] - middle))
    rows = np.flatnonzero(good)
    rows = rows[:: max(1, rows.size // 2000)]
    n = rows.size
    others = simulated[rows][:, None]
    target = Target(mismatch[rows], others)
    rest = float(target.rest @ target.rest)
    scaled = n * np.log(max(float(np.sum(mismatch[rows] ** 2)), 1e-12) / rest) > 30
    findings: list[dict[str, Any]] = []
    for _ in range(3):
        able = [f for f in library if possible(f.effect, component, f.drivers)]
        left = [n * target.explained(f.design[rows])[1] ** 2 + f.design.shape[1] * 8 * rest / n for f in able]
        k = int(np.argmin(left))
        if n / 4 * np.log(rest / left[k]) < PAYS or left[k] > (1 - MIN_GAIN) * rest:
            break
        sure = 0.8 if left[k] < (1 - SURE_GAIN) * rest else 0.6
        findings.append({"effect": able[k].effect, "confidence": sure, "drivers": list(able[k].drivers)})
        others, rest = np.hstack([others, able[k].design[rows]]), left[k]
        target = Target(mismatch[rows], others)
    verdict = "missing_physics" if findings else "recalibrate" if scaled else "no_mismatch"
    return {"component": component, "verdict": verdict, "rms_after_um": float(np.sqrt(rest / n)), "findings": findings}


def main() -> None:
    parser = argparse.ArgumentParser(description="What a greedy regression over textbook forms says.")
    parser.add_argument("out", type=Path)
    a = parser.parse_args()
    for folder in sorted((a.out / "cases").iterdir()):
        target = a.out / "baseline" / folder.name / "diagnosis.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(json.dumps(diagnose(folder), indent=1) + "\n")
    judged = score(a.out, a.out / "baseline")
    print(markdown(judged, f"{len(judged)} cases, greedy regression over textbook forms"))
    print(wrong_ones(judged))


if __name__ == "__main__":
    main()
