"""Real twins: nulls and additions made from real recordings, diagnosed and judged.

python -m trials.real --from FOLDER [FOLDER ...] --seed 7 [--nulls 20] [--additions 25] [--jobs 1] [--keep DIR]
                      [--json FILE] [--markdown FILE]

FOLDER: a recording folder, a measurement file that errpipe reads, or a folder of such.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

from trials.command import add_reports, write_reports
from trials.judge import judge, read
from trials.run import diagnose_all

from .draw import generate
from .recordings import sources

ALARM, SURE = 0.5, 0.8


def judge_all(out: Path) -> list[dict[str, Any]]:
    """One row for each case: quiet or named, and what was said."""
    rows = []
    for path in sorted((out / "answers").glob("*.json")):
        key = json.loads(path.read_text())
        responses = read(out / "diagnoses" / key["case"] / "diagnosis.json")
        ((component, wanted),) = key["responses"].items()
        answer = (responses or {}).get(component)
        findings = [f for f in (answer or {}).get("findings") or [] if f["effect"] != "recalibration"]
        names = {e for group in wanted["effects"] for e in group}
        wrong = [f for f in findings if f["effect"] not in {*names, "unknown"}]
        judged = judge(out / "cases" / key["case"], key, responses)
        rows.append(
            {
                "case": key["case"],
                "tier": key["tier"],
                "source": key["protocol"],
                "truth": wanted["truth"],
                "right": judged.correct,
                "alarm": next((f["effect"] for f in findings if f["confidence"] >= ALARM), None),
                "confident_wrong": any(f["confidence"] >= SURE for f in wrong),
                "sizes": judged.params,
                "said": [f"{f['effect']} {f['confidence']:.2f}" for f in findings]
                or [(answer or {}).get("verdict", "no answer")],
                "ran": answer is not None,
            }
        )
    return rows


def quiet(row: dict[str, Any]) -> bool:
    """A null to which nothing was added, and in which nothing is said to be missing with 0.5 or more."""
    return row["ran"] and row["alarm"] is None


def figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The three figures of the page, and what they are made of."""
    nulls, added = [r for r in rows if r["tier"] == "null"], [r for r in rows if r["tier"] != "null"]
    sizes = [s for r in added for s in r["sizes"]]
    return {
        "nulls": len(nulls),
        "quiet": sum(map(quiet, nulls)),
        "unknown_alarms": sum(r["alarm"] == "unknown" for r in nulls),
        "additions": len(added),
        "named": sum(r["right"] for r in added),
        "confident_wrong": sum(r["confident_wrong"] for r in rows),
        "sizes": len(sizes),
        "sizes_in_interval": sum(sizes),
    }


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / whole:.0f} %)" if whole else "–"


def markdown(rows: list[dict[str, Any]], title: str) -> str:
    """Figures by source and in all."""
    by: dict[str, list] = defaultdict(list)
    for r in rows:
        by[r["source"]].append(r)
    head = ["recording, kind of repetition", "nulls quiet", "additions named", "confident wrong names"]
    lines = [title, "", f"| {' | '.join(head)} |", "| --- | ---: | ---: | ---: |"]
    for name, part in [*sorted(by.items()), ("all", rows)]:
        f = figures(part)
        lines.append(
            f"| {name} | {_share(f['quiet'], f['nulls'])} | {_share(f['named'], f['additions'])} "
            f"| {_share(f['confident_wrong'], f['nulls'] + f['additions'])} |"
        )
    f = figures(rows)
    lines += [
        "",
        f"Alarms of `unknown` on nulls: {f['unknown_alarms']}. Sizes in their interval: "
        f"{_share(f['sizes_in_interval'], f['sizes'])}.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description="Real twins: nulls and additions made from real recordings.")
    parser.add_argument("--from", dest="folders", type=Path, nargs="+", required=True)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--nulls", type=int, default=20)
    parser.add_argument("--additions", type=int, default=25)
    parser.add_argument("--jobs", type=int, default=1)
    add_reports(parser)
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out = a.keep or Path(temporary) / "real"
        try:
            pool = generate(out, sources(a.folders), a.seed, a.nulls, a.additions)
        except ValueError as err:
            raise SystemExit(str(err)) from None
        print("; ".join(f"{name}: {count}" for name, count in pool.items()))
        diagnose_all(out / "cases", out / "diagnoses", a.jobs)
        rows = judge_all(out)
    text = markdown(rows, f"{len(rows)} real twins, seed {a.seed}")
    print(text)
    for r in rows:
        if r["confident_wrong"] or not (quiet(r) if r["tier"] == "null" else r["right"]):
            print(r["case"], r["tier"], r["source"], *r["truth"], "->", ", ".join(r["said"]))
    write_reports(a, text, {"figures": figures(rows), "cases": rows})


if __name__ == "__main__":
    main()
