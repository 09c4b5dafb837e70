"""Diagnoses made from keys, to try a judge: python -m trials.second.perfect CASES DIAGNOSES."""

from __future__ import annotations

import json
import sys
from pathlib import Path


def response(component: str, key: dict) -> dict:
    """What a diagnosis would say of one response that knows its key."""
    findings = [finding(group[0], key) for group in key["effects"]]
    after = {"scheme": "from the key", "rms_before_um": key["before_rms"], "rms_after_um": key["noise_rms"]}
    return {"component": component, "verdict": key["verdict"][0], "findings": findings, "holdout": after}


def finding(effect: str, key: dict) -> dict:
    stated = [
        {"name": n, "value": p["value"], "unit": p["unit"], "ci95": [0.98 * p["value"], 1.02 * p["value"]]}
        for n, p in key["params"].items()
        if n.split(".")[0] == effect
    ]
    sure = 0.6 if effect == "unknown" else 0.95
    drivers = key["drivers"].get(effect, [])
    return {"effect": effect, "confidence": sure, "drivers": drivers, "where": key["where"] or {}, "parameters": stated}


def diagnosis(key: dict) -> dict:
    """A whole diagnosis (contract version 1) that agrees with a key."""
    responses = [response(c, k) for c, k in key["responses"].items()]
    return {"diagnosis": 1, "recording": key["case"], "responses": responses}


def main(argv: list[str]) -> int:
    cases, out = Path(argv[0]), Path(argv[1])
    for answer in sorted(cases.glob("*/answer.json")):
        folder = out / answer.parent.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "diagnosis.json").write_text(json.dumps(diagnosis(json.loads(answer.read_text()))))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
