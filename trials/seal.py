"""Answers written beside their digests before any recording is diagnosed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any


def seal(out: Path, keys: dict[str, dict[str, Any]]) -> None:
    """out/answers/<id>.json and out/answers.sha256, which `trials.score` checks before it reads them."""
    (out / "answers").mkdir(parents=True, exist_ok=True)
    lines = []
    for name, key in sorted(keys.items()):
        text = json.dumps(key, indent=1) + "\n"
        (out / "answers" / f"{name}.json").write_text(text)
        lines.append(f"{hashlib.sha256(text.encode()).hexdigest()}  answers/{name}.json\n")
    (out / "answers.sha256").write_text("".join(lines))
