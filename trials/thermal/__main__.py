"""Families of thermal models on machines nobody tuned for: fitted on two seasons, judged on the third.

python -m trials.thermal --seed 7 --machines 24 [--families season,auto] [--without-gate] [--log-days N] [--keep DIR]
                         [--json FILE] [--markdown FILE]

With --log-days one run of N days is fitted, and four later logs of the same season judge.

The families run by their public commands (`errpipe run`, `errpipe predict`) in a process of their own. What is not
exported counts as no compensation; with --without-gate the fitted model itself is judged, in this process, which takes
a tenth of the time. Baselines are computed here on the same rows.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trials import folder
from trials.command import add_reports, write_reports
from trials.folder import Array, Sheet

from . import logs
from .baselines import predictions, since_start
from .seasons import machine_of, recordings

COMPONENT = "E_Z"
PIPELINE = """\
pipeline: 1
title: thermal trial
stages:
  - {{kind: ingest, recording: fit}}
  - {{kind: fit, family: {family}, component: E_Z}}
  - {{kind: validate}}
  - {{kind: export, allow: [temperature-range]}}
"""  # a body of a generated network may run hotter than any machine's
GATE = 4
JUDGED_FROM = 1  # readings at a day's start from which everything that is judged counts, as a table does


def errpipe(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own."""
    line = [sys.executable, "-m", "errpipe.cli.app", *words]
    return subprocess.run(line, cwd=cwd, capture_output=True, text=True, check=False)


def by_family(where: Path, family: str, judged: Sheet) -> dict[str, Any]:
    """One family on one machine: the judged rows' prediction, whether it was exported, coverage of its interval."""
    (where / f"{family}.yaml").write_text(PIPELINE.format(family=family))
    ran = errpipe("run", f"{family}.yaml", "--out", family, cwd=where)
    if ran.returncode not in (0, GATE):
        return {"failed": (ran.stderr or ran.stdout).strip().splitlines()[-1:]}
    model = next(iter(sorted((where / family).rglob("error_model.json"))), None)
    if model is None:
        return {"failed": ["no error model was written"]}
    asked = errpipe("predict", str(model.resolve()), "judge", "--out", f"{family}.csv", cwd=where)
    if asked.returncode:
        return {"failed": asked.stderr.strip().splitlines()[-1:]}
    table = pd.read_csv(where / f"{family}.csv")
    by_name: dict[str, Any] = {"exported": ran.returncode == 0}
    by_name["prediction"] = since_start(table[f"{COMPONENT}_predicted"].to_numpy(float), judged.runs(), JUDGED_FROM)
    low, high = (table.get(f"{COMPONENT}_{side}") for side in ("lower", "upper"))
    if low is not None and high is not None and low.notna().any():
        by_name |= coverage(judged, by_name["prediction"], 0.5 * (high - low).to_numpy(float))
    return by_name


def by_training(where: Path, family: str, judged: Sheet) -> dict[str, Any]:
    """`by_family` without validation, gate and processes of its own."""
    from errpipe.errors import ErrpipeError
    from errpipe.formats import manifest_folder
    from errpipe.models import FAMILIES

    fit, recording = (manifest_folder.read(where / name) for name in ("fit", "judge"))
    asked: Any = FAMILIES[family](component=COMPONENT)
    try:
        told = asked.train(fit, None).predict(recording)
    except ErrpipeError as e:
        return {"failed": [str(e)]}
    predicted = since_start(told.predicted, judged.runs(), JUDGED_FROM)
    half = 0.5 * (told.upper - told.lower)
    return {"exported": True, "judged_without_gate": True, "prediction": predicted} | coverage(judged, predicted, half)


def coverage(judged: Sheet, predicted: Array, half: Array) -> dict[str, float]:
    """Share of the rows inside the interval, and its mean width over the one that would hold 90 %."""
    left = np.abs(since_start(judged.values(COMPONENT), judged.runs(), JUDGED_FROM) - predicted)
    needed = float(np.quantile(left, 0.9))
    return {"covered": float(np.mean(left <= half)), "width": float(np.mean(half)) / max(needed, 1e-9)}


def noise_floor(seed: int, number: int) -> float:
    """What a perfect model would leave: a reading's noise, and that of the one that is a day's zero."""
    return machine_of(seed, number)[1].reading_noise * (1 + 1 / JUDGED_FROM) ** 0.5


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def one_machine(
    where: Path, seed: int, number: int, families: list[str], gate: bool = True, log_days: int = 0
) -> dict[str, Any]:
    """Left-out-season rms of every family and baseline over that of no compensation; log_days: of later logs."""
    fit, judged = logs.recordings(seed, number, log_days) if log_days else recordings(seed, number)
    folder.write(where / "fit", fit)
    folder.write(where / "judge", judged)
    y = since_start(judged.values(COMPONENT), judged.runs(), JUDGED_FROM)
    nothing = rms(y)
    row: dict[str, Any] = {"machine": fit.machine, "uncompensated_um": nothing, "left": {}, "families": {}}
    for name, predicted in predictions(fit, judged, COMPONENT).items():
        row["left"][name] = rms(y - since_start(predicted, judged.runs(), JUDGED_FROM)) / nothing
    row["left"]["noise of a reading"] = noise_floor(seed, number) / nothing
    for family in families:
        result = (by_family if gate else by_training)(where, family, judged)
        if "prediction" in result:
            row["left"][family] = rms(y - result["prediction"]) / nothing if result["exported"] else 1.0
            row.setdefault("left_if_exported", {})[family] = rms(y - result.pop("prediction")) / nothing
        row["families"][family] = result
    return row


def geometric(values: list[float]) -> float:
    return float(np.exp(np.mean(np.log(values)))) if values else float("nan")


def markdown(rows: list[dict[str, Any]], title: str) -> str:
    """By kind of machine: geometric mean of what is left, share at most lasso, never worse than nothing."""
    methods = list(dict.fromkeys(m for r in rows for m in r["left"]))
    kinds = sorted({r["machine"].split("-")[0] for r in rows})
    head = ["rows left out: residual over uncompensated, geometric mean", *kinds, "all", "at most lasso", "worst"]
    lines = [title, "", f"| {' | '.join(head)} |", f"| --- |{' ---: |' * (len(head) - 1)}"]
    for m in methods:
        cells = []
        for kind in [*kinds, ""]:
            own = [r["left"][m] for r in rows if m in r["left"] and r["machine"].startswith(kind)]
            cells.append(f"{geometric(own):.3f}" if own else "–")
        known = [r for r in rows if m in r["left"]]
        level = sum(r["left"][m] <= r["left"]["lasso"] * 1.0000001 for r in known)
        lines.append(
            f"| {m} | {' | '.join(cells)} | {level} of {len(known)} | {max(r['left'][m] for r in known):.2f} |"
        )
    for family in dict.fromkeys(f for r in rows for f in r["families"]):
        of = [r["families"][family] for r in rows]
        covered = [f["covered"] for f in of if "covered" in f]
        gated = [f for f in of if "judged_without_gate" not in f]
        text = f"{family}: exported on {sum(bool(f.get('exported')) for f in gated)} of {len(gated)}"
        text = text if gated else f"{family}: judged without the gate of an export"
        text += f", failed on {sum('failed' in f for f in of)}"
        if covered:
            text += f"; 90 % interval covers {100 * np.mean(covered):.0f} %, "
            text += f"{np.median([f['width'] for f in of if 'width' in f]):.1f} times as wide as needed (median)"
        lines += ["", text + "."]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description="Thermal families on machines nobody tuned for.")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--machines", type=int, default=24)
    parser.add_argument("--families", default="season,auto", help="comma-separated; empty: baselines only")
    parser.add_argument("--without-gate", action="store_true")
    parser.add_argument("--log-days", type=int, default=0)
    add_reports(parser)
    a = parser.parse_args()
    families = [f for f in a.families.split(",") if f]
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        for number in range(a.machines):
            where = (a.keep or Path(temporary)) / f"machine-{number}"
            row = one_machine(where, a.seed, number, families, not a.without_gate, a.log_days)
            rows.append(row)
            left = ", ".join(f"{m} {v:.3f}" for m, v in row["left"].items())
            failed = "; ".join(f"{f}: {v['failed']}" for f, v in row["families"].items() if "failed" in v)
            print(f"{row['machine']} {row['uncompensated_um']:.1f} um: {left} {failed}", flush=True)
    text = markdown(rows, f"{len(rows)} machines, seed {a.seed}")
    print(text)
    write_reports(a, text, {"machines": rows})


if __name__ == "__main__":
    main()
