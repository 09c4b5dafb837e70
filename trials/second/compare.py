"""Compare cases with the public sample: python -m trials.second.compare CASES [PUBLIC].

Prints rows, runs, shares of empty cells and the ratios of the keys, per protocol and per tier.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pandas as pd


def figures(folder: Path) -> list[dict]:
    """One row of figures for each response of each case."""
    out = []
    for answer in sorted(folder.glob("*/answer.json")):
        key = json.loads(answer.read_text())
        frame = pd.read_csv(answer.parent / "recording.csv", dtype={"run": str})
        for name, k in key["responses"].items():
            out.append(_response(key, frame, name, k))
    return out


def _response(key: dict, frame: pd.DataFrame, name: str, k: dict) -> dict:
    mismatch = (frame[name] - frame[f"{name}_sim"]).to_numpy()
    filled = mismatch[~np.isnan(mismatch)]
    middle = pd.Series(filled).rolling(9, center=True, min_periods=1).median().to_numpy()
    gains = np.abs(np.array(list(k["in_the_simulation"].values())) - 1)
    return {
        "tier": key["tier"] if k["effects"] or key["tier"] == "null" else "beside",
        "protocol": key["protocol"],
        "rows": len(frame),
        "runs": frame["run"].nunique(),
        "measured": len(filled),
        "outliers %": 100 * float(np.mean(np.abs(filled - middle) > 5 * k["noise_rms"])),
        "noise": k["noise_rms"],
        "before/noise": k["before_rms"] / k["noise_rms"],
        "oracle/noise": k["oracle_after_rms"] / k["noise_rms"],
        "simulated/noise": float(frame[f"{name}_sim"].std()) / k["noise_rms"],
        "included": len(gains),
        "largest gain off": float(gains.max()),
    }


NUMBERS = ["rows", "runs", "outliers %", "noise", "before/noise", "oracle/noise", "simulated/noise", "included"]
NUMBERS += ["largest gain off"]


def spread(rows: list[dict], by: str) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Smallest, median and largest of every figure, grouped."""
    groups = defaultdict(list)
    for r in rows:
        groups[r[by]].append(r)
    return {
        g: {n: tuple(float(v) for v in np.quantile([r[n] for r in rs], [0, 0.5, 1])) for n in NUMBERS}
        for g, rs in sorted(groups.items())
    }


def main(argv: list[str]) -> int:
    ours = figures(Path(argv[0]))
    public = figures(Path(argv[1])) if len(argv) > 1 else []
    for by in ("protocol", "tier"):
        there = spread(public, by)
        for group, match in spread(ours, by).items():
            print(f"\n{by} {group}")
            for n, v in match.items():
                old = there.get(group, {}).get(n)
                text = f"   public {old[0]:9.2f} {old[1]:9.2f} {old[2]:9.2f}" if old else ""
                print(f"  {n:<18}{v[0]:9.2f} {v[1]:9.2f} {v[2]:9.2f}{text}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
