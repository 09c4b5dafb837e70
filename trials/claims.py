"""Claims that are physically impossible, independent of the key."""

from __future__ import annotations

from typing import Any

from .folder import Sheet

SURE = 0.5  # confidence from which a finding is a claim
TIMES_THE_MISMATCH = 4.0  # a size beyond this many times the mismatch's span of 6 rms has another that cancels it
LENGTH_ONLY = ("um/m", "um/m/K", "um/mm", "ppm/K", "um/(m K)")


def impossible(sheet: Sheet, component: str, response: dict[str, Any], mismatch: float) -> list[str]:
    """One line for each claim that cannot be true."""
    out = []
    rotary = {n for n in sheet.names("position") if sheet.columns[n].get("unit") == "deg"}
    unit = sheet.columns[sheet.responses()[component][0]].get("unit")
    for finding in response.get("findings") or []:
        if finding["effect"] == "recalibration" or float(finding["confidence"]) < SURE:
            continue
        parameters = finding.get("parameters") or []
        intervals = [p for p in parameters if p.get("ci95")]
        spans = [p for p in intervals if p["ci95"][0] < 0 < p["ci95"][1]]
        if intervals and len(spans) == len(intervals):
            out.append(f"{component}: {finding['effect']}: every interval spans zero")
        for p in parameters:
            if str(p.get("unit")) in LENGTH_ONLY and rotary & set(finding.get("drivers") or []):
                out.append(f"{component}: {finding['effect']}: {p['unit']} on a rotary axis")
            if unit == "urad" and str(p.get("unit")).startswith("um"):
                out.append(f"{component}: {finding['effect']}: {p['unit']} on an angle in urad")
            if p.get("unit") == unit and abs(p["value"]) > TIMES_THE_MISMATCH * 6 * mismatch:
                out.append(f"{component}: {finding['effect']}: {p['value']:g} {p['unit']}, mismatch {mismatch:.3g} rms")
    return out
