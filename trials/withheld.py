"""Every hidden effect taken out of the library in turn: does the diagnosis then admit that it does not know?

python -m trials.withheld --seed 7 --cases 72 --jobs 2 [--json FILE]

Cases with one hidden effect are diagnosed by a library that lacks it, and all names that its key accepts.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from .first.generate import generate
from .score import sealed_answers

SURE = 0.8  # confidence from which a name counts as a claim
SINGLE = ("plain", "concealed", "partial")


def hidden(key: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """(component, accepted names) of each response from which something is missing."""
    return [(c, group) for c, r in key["responses"].items() for group in r["effects"]]


def without(case: str, component: str, names: tuple[str, ...]) -> dict[str, Any]:
    """Diagnosis of a response by a library without these effects. Runs in a worker process."""
    from errpipe.diagnosis import diagnose, hypotheses
    from errpipe.formats import manifest_folder

    every = hypotheses.TERMS
    hypotheses.TERMS = tuple(kind for kind in every if kind.reports_as not in names)
    try:
        document = diagnose(manifest_folder.read(Path(case)))[0].document()
    finally:
        hypotheses.TERMS = every
    (response,) = [r for r in document["responses"] if r["component"] == component]
    named = [f for f in response["findings"] if f["effect"] != "recalibration"]
    return {
        "hidden": names[0],
        "verdict": response["verdict"],
        "said": named[0]["effect"] if named else response["verdict"],
        "confidence": max((f["confidence"] for f in named if f["effect"] != "unknown"), default=0.0),
    }


def run(folder: Path, jobs: int) -> list[dict[str, Any]]:
    """All cases of a folder with one hidden effect."""
    work = []
    for key in sealed_answers(folder):
        one = hidden(key)
        if key["tier"] in SINGLE and len(one) == 1:
            work.append((str(folder / "cases" / key["case"]), one[0][0], tuple(one[0][1])))
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(without, *zip(*work, strict=True)))


def figures(said: list[dict[str, Any]]) -> dict[str, Any]:
    """Shares of the cases: admitted as unknown, named surely, named with little confidence, taken for nothing."""
    kinds = Counter(
        "admitted"
        if s["said"] == "unknown"
        else "named surely"
        if s["confidence"] >= SURE
        else "named with doubt"
        if s["verdict"] == "missing_physics"
        else "taken for nothing missing"
        for s in said
    )
    return {"cases": len(said), **{k: kinds[k] / len(said) for k in sorted(kinds)}}


def main() -> None:
    parser = argparse.ArgumentParser(description="Blind trials with the hidden effect withheld from the library.")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cases", type=int, default=72)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "trials"
        generate(folder, a.seed, a.cases, None, None, None)
        said = run(folder, a.jobs)
    for s in said:
        print(f"{s['hidden']} withheld: {s['said']} ({s['confidence']:.2f})")
    for name, value in figures(said).items():
        print(f"{name}: {value:.0%}" if name != "cases" else f"{value} cases")
    if a.json:
        a.json.write_text(json.dumps({"seed": a.seed, "figures": figures(said), "cases": said}, indent=1) + "\n")


if __name__ == "__main__":
    main()
