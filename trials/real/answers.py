"""Real recordings that stand beside a simulation, with a published answer: what the diagnosis says of them.

python -m trials.real.answers --from FOLDER [FOLDER ...]

The key of a recording is its ANSWER.yaml: `accept`, the effects it may be called; `driver`, columns that drive it. The
diagnosis sees a copy of the folder without the key.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from trials.judge import read
from trials.run import diagnose


def answered(paths: list[Path]) -> list[Path]:
    """The folders among these, and in them, that hold a key."""
    out = []
    for path in paths:
        here = (path / "ANSWER.yaml").is_file()
        out += [path] if here else answered(sorted(p for p in path.iterdir() if p.is_dir())) if path.is_dir() else []
    return out


def judge_one(folder: Path) -> dict[str, Any]:
    """What is said of one recording, and whether the first finding of every response is accepted."""
    key = YAML(typ="safe").load((folder / "ANSWER.yaml").read_text())
    with tempfile.TemporaryDirectory() as temporary:
        case, out = Path(temporary) / folder.name, Path(temporary) / "out"
        shutil.copytree(folder, case, ignore=shutil.ignore_patterns("ANSWER.yaml", "SOURCE.txt"))
        _, seconds, trouble = diagnose(str(case), str(out))
        responses = read(out / "diagnosis.json") or {}
    said, right = [], bool(responses)
    for component, response in responses.items():
        findings = [f for f in response.get("findings") or [] if f["effect"] != "recalibration"]
        first = findings[0] if findings else {"effect": response["verdict"], "confidence": 0.0}
        named = first["effect"] in key["accept"] or (first["effect"] == "unexplained" and "unknown" in key["accept"])
        driven = first["effect"] == "unknown" or bool({*first.get("drivers", [])} & {*_listed(key.get("driver"))})
        right &= named and driven
        sizes = "; ".join(f"{p['name']} {p['value']:.3g} {p['unit']}" for p in first.get("parameters") or [])
        said.append(f"{component}: {first['effect']} {first['confidence']:.2f} ({sizes})")
    return {
        "recording": folder.name,
        "right": right,
        "said": said or [trouble],
        "size": key["size"],
        "seconds": seconds,
    }


def _listed(value: Any) -> list[str]:
    return value if isinstance(value, list) else [value] if value else []


def main() -> None:
    parser = argparse.ArgumentParser(description="Real recordings with a published answer.")
    parser.add_argument("--from", dest="folders", type=Path, nargs="+", required=True)
    rows = [judge_one(folder) for folder in answered(parser.parse_args().folders)]
    print("| recording | published | said first | right |\n| --- | --- | --- | --- |")
    for r in rows:
        print(f"| {r['recording']} | {r['size']} | {'; '.join(r['said'])} | {'yes' if r['right'] else 'no'} |")
    print(f"\n{sum(r['right'] for r in rows)} of {len(rows)} right")


if __name__ == "__main__":
    main()
