"""The rules by which a diagnosis is judged against its key (after the public sample's page, "Judging")."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .units import ratio

VERDICTS = ("no_mismatch", "recalibrate", "missing_physics", "unexplained")
ALARM, SURE, LOOK, PLACE = 0.5, 0.8, 3, 0.5


@dataclass
class Judged:
    """One case; None or an empty list where a question does not apply."""

    case: str
    tier: str
    protocol: str
    truth: list[str]
    ran: bool = False
    said: list[str] = field(default_factory=list)
    verdict: bool = False
    top1: bool | None = None
    every: bool | None = None
    alarms: int = 0
    quiet: int = 0  # responses from which nothing is missing
    quiet_alarmed: int = 0
    abstained: list[bool] = field(default_factory=list)  # per response with something missing
    bold: bool | None = None  # novel: a name with high confidence
    drivers: list[bool] = field(default_factory=list)
    location: list[float] = field(default_factory=list)
    params: list[bool] = field(default_factory=list)
    recovered: list[float] = field(default_factory=list)
    points: list[tuple[float, bool]] = field(default_factory=list)
    correct: bool = False
    missed: list[str] = field(default_factory=list)


def read(path: Path) -> dict[str, dict] | None:
    """Responses by component, or None where the file is missing or not a diagnosis."""
    try:
        document = json.loads(path.read_text())
        responses = {}
        for response in document["responses"]:
            if response["verdict"] not in VERDICTS:
                return None
            findings = response.get("findings") or []
            for finding in findings:
                if not isinstance(finding["effect"], str) or not 0 <= float(finding["confidence"]) <= 1:
                    return None
            responses[str(response["component"])] = response
        return responses
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def judge(folder: Path, key: dict[str, Any], responses: dict[str, dict] | None) -> Judged:
    """Judge one case; `folder` holds its recording."""
    truth = [t for k in key["responses"].values() for t in k["truth"]]
    out = Judged(key["case"], key["tier"], key["protocol"], truth)
    if responses is None:
        return out
    out.ran = True
    verdicts, correct = [], []
    for component, wanted in key["responses"].items():
        answer = responses.get(component)
        if answer is None:
            verdicts.append(False)
            correct.append(False)
            out.missed.append(f"{component}: no answer")
            continue
        findings = [f for f in answer.get("findings") or [] if f["effect"] != "recalibration"]
        accepted = {e for group in wanted["effects"] for e in group}
        out.points += [(float(f["confidence"]), f["effect"] in accepted) for f in findings]
        wrong = [f for f in findings if f["effect"] not in accepted and float(f["confidence"]) >= ALARM]
        out.alarms += len(wrong)
        fits = answer["verdict"] in wanted["verdict"]
        if not wanted["effects"]:
            right = _quiet(out, component, wanted, answer, findings, wrong, fits, verdicts)
        elif key["tier"] == "novel":
            right = _novel(out, component, answer, findings, fits, verdicts)
        else:
            right = _missing(out, folder, component, wanted, answer, findings, accepted, fits, verdicts)
        correct.append(right)
    out.verdict = bool(verdicts) and all(verdicts)
    out.correct = bool(correct) and all(correct)
    return out


def _quiet(out, component, wanted, answer, findings, wrong, fits, verdicts) -> bool:
    out.quiet += 1
    out.quiet_alarmed += bool(wrong)
    if out.tier != "null":
        if wrong:
            out.missed.append(f"{component}: alarm {wrong[0]['effect']} {wrong[0]['confidence']}")
        return not wrong
    verdicts.append(fits)
    out.said.append(findings[0]["effect"] if findings and wrong else answer["verdict"])
    if not fits or wrong:
        names = ", ".join(f"{f['effect']} {f['confidence']}" for f in findings[:2])
        out.missed.append(f"{component}: {answer['verdict']} instead of {wanted['verdict'][0]}; {names}")
    return fits and not wrong


def _novel(out, component, answer, findings, fits, verdicts) -> bool:
    verdicts.append(fits)
    out.bold = any(f["effect"] != "unknown" and float(f["confidence"]) >= SURE for f in findings)
    first = findings[0]["effect"] if findings else None
    admitted = answer["verdict"] == "unexplained" or first == "unknown"
    out.abstained.append(admitted or not findings)
    out.said.append("unknown" if admitted else first or answer["verdict"])
    right = fits and admitted and not out.bold
    out.top1 = right
    if not right:
        out.missed.append(f"{component}: {answer['verdict']}, {first} {findings[0]['confidence'] if findings else ''}")
    return right


def _missing(out, folder, component, wanted, answer, findings, accepted, fits, verdicts) -> bool:
    verdicts.append(fits)
    first = findings[0]["effect"] if findings else None
    out.said.append(first or answer["verdict"])
    out.abstained.append(first in (None, "unknown"))
    top = first in accepted
    hits: list[dict | None] = []
    taken: set[int] = set()
    for group in wanted["effects"]:
        match = next((i for i, f in enumerate(findings[:LOOK]) if f["effect"] in group and i not in taken), None)
        taken |= {match} if match is not None else set()
        hits.append(findings[match] if match is not None else None)
    out.top1 = top if out.top1 is None else out.top1 and top
    single = len(wanted["effects"]) == 1
    complete = all(h is not None for h in hits)
    if not single:
        out.every = complete
    right = fits and top and (single or complete)
    for group, hit in zip(wanted["effects"], hits, strict=True):
        if hit is not None:
            _details(out, folder, wanted, group, hit, single)
    if right:
        claimed = (answer.get("holdout") or {}).get("rms_after_um", answer.get("rms_after_um"))
        if isinstance(claimed, (int, float)) and math.isfinite(claimed):
            out.recovered.append(claimed / wanted["noise_rms"])
    else:
        names = ", ".join(f"{f['effect']} {f['confidence']}" for f in findings[:3])
        out.missed.append(f"{component}: {answer['verdict']}; {names or 'nothing named'}")
    return right


def _details(out: Judged, folder: Path, wanted: dict, group: list[str], hit: dict, single: bool) -> None:
    known = set(wanted["drivers"].get(hit["effect"]) or wanted["drivers"].get(group[0]) or [])
    given = {d for d in hit.get("drivers") or [] if isinstance(d, str)}
    out.drivers.append(bool(given & known) and len(given - known) <= len(given & known))
    if single and wanted.get("where"):
        out.location.append(place(folder, wanted["where"], hit.get("where")))
    for name, true in wanted["params"].items():
        if name.split(".")[0] == hit["effect"]:
            inside = covers(true, hit.get("parameters") or [])
            if inside is not None:
                out.params.append(inside)


def covers(true: dict, parameters: list[dict]) -> bool | None:
    """Whether the true size lies in the ci95 of a parameter of a compatible unit; None where none is stated."""
    seen = []
    for p in parameters:
        try:
            factor = ratio(str(p["unit"]), true["unit"])
            if factor is None or not p.get("ci95"):
                continue
            a, b = (float(v) * factor for v in p["ci95"])
        except (KeyError, TypeError, ValueError):
            continue
        low, high = sorted((abs(a), abs(b)))
        seen.append((0.0 if a * b < 0 else low) <= true["value"] <= high)
    return any(seen) if seen else None


def place(folder: Path, wanted: dict, given: dict | None) -> float:
    """Overlap of runs, of ranges, or of the rows that both describe, whichever is best."""
    given = given if isinstance(given, dict) else {}
    if not (given.get("runs") or given.get("ranges")):
        return 0.0
    scores = []
    if wanted.get("runs") and given.get("runs"):
        scores.append(_jaccard({str(r) for r in wanted["runs"]}, {str(r) for r in given["runs"]}))
    for column, limits in (wanted.get("ranges") or {}).items():
        if column in (given.get("ranges") or {}):
            scores.append(_overlap(limits, given["ranges"][column]))
    with open(folder / "recording.csv", newline="") as stream:
        table = list(csv.DictReader(stream))
    errors = [c for c in table[0] if f"{c}_sim" in table[0]]
    rows = [r for r in table if any(r[c] for c in errors)]
    by_rows = _jaccard(_rows(rows, wanted), _rows(rows, given))
    return max(min(scores) if scores else 0.0, by_rows)


def _jaccard(a: set, b: set) -> float:
    return len(a & b) / len(a | b) if a | b else 0.0


def _overlap(a: list[float], b: list[float]) -> float:
    (lo, hi), (c, d) = sorted(map(float, a)), sorted(map(float, b))
    union = max(hi, d) - min(lo, c)
    return max(0.0, min(hi, d) - max(lo, c)) / union if union > 0 else 0.0


def _rows(rows: list[dict[str, str]], where: dict) -> set[int]:
    runs = {str(r) for r in where.get("runs") or []}
    ranges = {c: sorted(map(float, limits)) for c, limits in (where.get("ranges") or {}).items()}
    out = set()
    for i, row in enumerate(rows):
        if runs and row["run"] not in runs:
            continue
        if all(row.get(c) and lo <= float(row[c]) <= hi for c, (lo, hi) in ranges.items()):
            out.add(i)
    return out
