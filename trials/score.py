"""Judge diagnoses of generated cases.

    python -m trials.score OUT_DIR DIAGNOSES_DIR [--json FILE]

OUT_DIR is what `generate` wrote; DIAGNOSES_DIR/<id>/diagnosis.json is what errpipe said.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

from .first.assemble import TIERS
from .judge import Judged, judge, read


class Tampered(Exception):
    """The answers are not those that were sealed."""


def sealed_answers(out: Path) -> list[dict[str, Any]]:
    """The keys, after their digests agreed with those written before anything was opened."""
    keys = []
    for line in (out / "answers.sha256").read_text().splitlines():
        digest, name = line.split("  ", 1)
        data = (out / name).read_bytes()
        if hashlib.sha256(data).hexdigest() != digest:
            raise Tampered(f"{name} is not the answer that was sealed")
        keys.append(json.loads(data))
    return keys


def score(out: Path, diagnoses: Path) -> list[Judged]:
    """All cases judged, in the order of their ids."""
    return [
        judge(out / "cases" / k["case"], k, read(diagnoses / k["case"] / "diagnosis.json")) for k in sealed_answers(out)
    ]


def share(values: Iterable[bool]) -> float | None:
    values = list(values)
    return sum(values) / len(values) if values else None


def figures(judged: list[Judged]) -> dict[str, Any]:
    """The published figures of a set of cases."""
    missing = [j for j in judged if j.tier not in ("null", "novel")]
    recovered = [x for j in judged for x in j.recovered]
    points = [p for j in judged for p in j.points]
    nulls = [j for j in judged if j.tier == "null"]
    return {
        "cases": len(judged),
        "ran": sum(j.ran for j in judged),
        "correct": share(j.correct for j in judged),
        "verdict": share(j.verdict for j in judged),
        "first_right": share(j.top1 for j in judged if j.top1 is not None),
        "both_found": share(j.every for j in judged if j.every is not None),
        "alarms_on_nulls": share(j.quiet_alarmed > 0 for j in nulls),
        "alarms_on_quiet_responses": (
            sum(j.quiet_alarmed for j in judged) / q if (q := sum(j.quiet for j in judged)) else None
        ),
        "abstained_on_known": share(a for j in missing for a in j.abstained),
        "admitted_on_novel": share(a for j in judged if j.tier == "novel" for a in j.abstained),
        "bold_on_novel": share(j.bold for j in judged if j.bold is not None),
        "drivers": share(d for j in judged for d in j.drivers),
        "location": share(x >= 0.5 for j in judged for x in j.location),
        "coverage": share(p for j in judged for p in j.params),
        "residual_over_noise": median(recovered) if recovered else None,
        "residual_over_1_15": share(x > 1.15 for x in recovered),
        "residual_below_0_9": share(x < 0.9 for x in recovered),
        "brier": sum((c - ok) ** 2 for c, ok in points) / len(points) if points else None,
    }


def reliability(judged: list[Judged]) -> list[dict[str, float]]:
    """Findings by stated confidence: how many were right."""
    points = [p for j in judged for p in j.points]
    out = []
    for low, high in ((0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.9), (0.9, 0.97), (0.97, 1.01)):
        part = [(c, ok) for c, ok in points if low <= c < high]
        if part:
            said, right = sum(c for c, _ in part) / len(part), sum(ok for _, ok in part) / len(part)
            out.append({"from": low, "to": min(high, 1), "findings": len(part), "said": said, "right": right})
    return out


def confusion(judged: list[Judged]) -> dict[str, dict[str, Any]]:
    """For each hidden effect: cases, right ones, and what was said first where it was wrong."""
    table: dict[str, dict[str, Any]] = defaultdict(lambda: {"cases": 0, "right": 0, "instead": Counter()})
    for j in judged:
        for name in [t.split(":")[0] for t in j.truth] or ["(nothing)"]:
            row = table[name]
            row["cases"] += 1
            row["right"] += j.correct
            if not j.correct:
                row["instead"]["+".join(j.said) or "no answer"] += 1
    return {k: {**v, "instead": dict(v["instead"].most_common())} for k, v in sorted(table.items())}


def _p(value: float | None, digits: int = 0) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f} %"


def markdown(judged: list[Judged], title: str) -> str:
    """The tables for the README: by tier, by effect, confidence."""
    head = ["tier", "cases", "right", "first right", "both found", "false alarms", "location", "intervals cover"]
    head.append("residual / noise")
    lines = [title, "", f"| {' | '.join(head)} |", f"| --- |{' ---: |' * 8}"]
    for tier in [*TIERS, "all"]:
        part = [j for j in judged if tier in (j.tier, "all")]
        if not part:
            continue
        f = figures(part)
        ratio = "–" if f["residual_over_noise"] is None else f"{f['residual_over_noise']:.2f}"
        lines.append(
            f"| {tier} | {f['cases']} | {_p(f['correct'])} | {_p(f['first_right'])} | {_p(f['both_found'])} "
            f"| {_p(f['alarms_on_quiet_responses'], 1)} | {_p(f['location'])} | {_p(f['coverage'])} | {ratio} |"
        )
    f = figures(judged)
    lines += [
        "",
        f"- false alarms on nulls: {_p(f['alarms_on_nulls'], 1)}",
        f"- known effects left unnamed: {_p(f['abstained_on_known'])}",
        f"- novel mechanisms admitted as unknown: {_p(f['admitted_on_novel'])}; "
        f"named with confidence 0.8 or more: {_p(f['bold_on_novel'])}",
        f"- right cases whose held-out residual is above 1.15 of the noise: {_p(f['residual_over_1_15'])}",
    ]
    lines += ["", "| stated confidence | findings | said | right |", "| --- | ---: | ---: | ---: |"]
    for r in reliability(judged):
        lines.append(f"| {r['from']:g} to {r['to']:g} | {r['findings']} | {r['said']:.2f} | {r['right']:.2f} |")
    lines += ["", "| hidden | cases | right | said instead |", "| --- | ---: | ---: | --- |"]
    for name, row in confusion(judged).items():
        instead = ", ".join(f"{k} {n}" for k, n in list(row["instead"].items())[:5])
        lines.append(f"| {name} | {row['cases']} | {row['right']} | {instead} |")
    return "\n".join(lines) + "\n"


def wrong_ones(judged: list[Judged]) -> str:
    """One line per case that was not right."""
    lines = []
    for j in judged:
        if not j.correct:
            what = "; ".join(j.missed) or "no answer"
            lines.append(f"{j.case} {j.tier}, {j.protocol}, {'+'.join(j.truth) or 'nothing'}: {what}")
    return "\n".join(lines)


def document(judged: list[Judged]) -> dict[str, Any]:
    """Everything, for a file."""
    return {
        "figures": figures(judged),
        "by_tier": {t: figures(p) for t in TIERS if (p := [j for j in judged if j.tier == t])},
        "reliability": reliability(judged),
        "confusion": confusion(judged),
        "cases": [asdict(j) for j in judged],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Judge diagnoses of generated cases.")
    parser.add_argument("out", type=Path)
    parser.add_argument("diagnoses", type=Path)
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    judged = score(a.out, a.diagnoses)
    print(markdown(judged, f"{len(judged)} cases"))
    print(wrong_ones(judged))
    if a.json:
        a.json.write_text(json.dumps(document(judged), indent=1) + "\n")


if __name__ == "__main__":
    main()
