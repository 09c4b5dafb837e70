"""What the README counts is what there is; with WRITE_EXPECTED=1 (`make generated`) the numbers are written again."""

from __future__ import annotations

import os
import re
from pathlib import Path

from errpipe.targets import TARGETS
from errpipe.terms import TERMS
from errpipe.verbs.init import TEMPLATES

ROOT = Path(__file__).parents[2]


def test_the_readme_counts_what_there_is() -> None:
    declared = (ROOT / "docs/wrong-declarations.md").read_text(encoding="utf-8").splitlines()
    there = {
        "effects": len({t.reports_as for t in TERMS} - {""}),
        "formats (`errpipe targets`": len(TARGETS),
        "templates:": len(TEMPLATES),
        "wrong declarations": sum(line.startswith("| ") for line in declared) - 2,  # without head and rule
    }
    readme = ROOT / "README.md"
    text = readme.read_text(encoding="utf-8")
    if os.environ.get("WRITE_EXPECTED"):
        for what, count in there.items():
            text = re.sub(rf"\d+ {re.escape(what)}", f"{count} {what}", text)
        readme.write_text(text, encoding="utf-8")
    counted = {what: int(m[1]) for what in there if (m := re.search(rf"(\d+) {re.escape(what)}", text))}
    assert counted == there, "`make generated` counts again"
