"""One textbook effect each on machines of every scale: draw, diagnose, judge.

python -m trials.scales --seed 7 --cases 100 --jobs 1 [--keep DIR] [--json FILE] [--markdown FILE] [--only EFFECTS]
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from trials import folder
from trials.claims import impossible
from trials.command import add_reports, print_failures, write_reports
from trials.judge import Judged, judge, read
from trials.run import diagnose_all

from .draw import generate, mismatch_rms, read_keys

SURE = 0.8


def outcome(judged: Judged, key: dict[str, Any], responses: dict[str, dict] | None) -> str:
    """right, unknown, nothing, wrong name, confident wrong name, no answer; unknown: the mismatch is admitted."""
    if responses is None:
        return "no answer"
    if judged.correct:
        return "right"
    ((component, wanted),) = key["responses"].items()
    accepted = {e for group in wanted["effects"] for e in group} | {"unknown", "recalibration"}
    findings = (responses.get(component) or {}).get("findings") or []
    if any(f["effect"] not in accepted and float(f["confidence"]) >= SURE for f in findings):
        return "confident wrong name"
    said = judged.said[0] if judged.said else "no_mismatch"
    if said in ("no_mismatch", "recalibrate", "unexplained"):
        return "nothing"
    return "unknown" if said == "unknown" else "incomplete" if said in accepted else "wrong name"


def judge_all(out: Path) -> list[dict[str, Any]]:
    """One row of figures for each case."""
    rows = []
    for name, key in read_keys(out).items():
        responses = read(out / "diagnoses" / name / "diagnosis.json")
        judged = judge(out / "cases" / name, key, responses)
        sheet = folder.read(out / "cases" / name)
        ((component, wanted),) = key["responses"].items()
        answer = (responses or {}).get(component) or {}
        rows.append(
            {
                "case": name,
                "bench": key["protocol"],
                "truth": wanted["truth"],
                "outcome": outcome(judged, key, responses),
                "said": [f"{f['effect']} {f['confidence']:.2f}" for f in answer.get("findings") or []]
                or [answer.get("verdict", "no answer")],
                "sizes": judged.params,
                "drivers": judged.drivers,
                "points": judged.points,
                "impossible": impossible(sheet, component, answer, mismatch_rms(sheet, component)),
            }
        )
    return rows


OUTCOMES = ("right", "unknown", "nothing", "incomplete", "wrong name", "confident wrong name", "no answer")


def markdown(rows: list[dict[str, Any]], title: str) -> str:
    """Outcomes by effect, and the sizes' coverage."""
    by: dict[str, Counter] = defaultdict(Counter)
    for r in rows:
        for group in (" + ".join(t.split(":")[0] for t in r["truth"]), "all"):
            by[group][r["outcome"]] += 1
            by[group]["cases"] += 1
            by[group]["in"] += sum(r["sizes"])
            by[group]["sizes"] += len(r["sizes"])
            by[group]["impossible"] += bool(r["impossible"])
    head = ["hidden", "cases", *OUTCOMES, "sizes in interval", "impossible claims"]
    lines = [title, "", f"| {' | '.join(head)} |", f"| --- |{' ---: |' * (len(head) - 1)}"]
    for name in [*sorted(n for n in by if n != "all"), "all"]:
        c = by[name]
        covered = f"{c['in']} of {c['sizes']}" if c["sizes"] else "–"
        counts = " | ".join(str(c[o]) for o in OUTCOMES)
        lines.append(f"| {name} | {c['cases']} | {counts} | {covered} | {c['impossible']} |")
    n, c = len(rows), by["all"]
    lines += [
        "",
        f"Right {100 * c['right'] / max(n, 1):.0f} %; named with 0.8 or more and wrong "
        f"{100 * c['confident wrong name'] / max(n, 1):.1f} %; sizes in their interval "
        f"{100 * c['in'] / max(c['sizes'], 1):.0f} %.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description="One textbook effect each on machines of every scale.")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", help="comma-separated effect ids (the named cases always run)")
    add_reports(parser)
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out = a.keep or Path(temporary) / "scales"
        generate(out, a.seed, a.cases, a.only)
        done = diagnose_all(out / "cases", out / "diagnoses", a.jobs)
        rows = judge_all(out)
    text = markdown(rows, f"{len(rows)} cases of one textbook effect, seed {a.seed}")
    print(text)
    for r in rows:
        if r["outcome"] != "right" or r["impossible"]:
            print(
                r["case"], r["bench"], "; ".join(r["truth"]), "->", r["outcome"], ", ".join(r["said"]), *r["impossible"]
            )
    print_failures(done)
    write_reports(a, text, {"cases": rows})


if __name__ == "__main__":
    main()
