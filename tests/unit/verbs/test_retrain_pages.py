"""Pages of a retraining for CI."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

from errpipe.verbs import _retrain_pages as pages

EMPTY: dict[str, list[Any]] = {key: [] for key in ("inputs", "residuals", "rms", "sizes", "changes", "runs")}


def document(*gates: tuple[str, bool], **drift: list[Any]) -> dict[str, Any]:
    return {"gates": [{"name": n, "passed": p, "says": f"{n} says"} for n, p in gates], "drift": EMPTY | drift}


def test_a_quiet_night_is_no_failure() -> None:
    """Evidence that has yet to come is red on no page; another gate that fails is."""
    quiet = document(("evidence", False), ("inputs", True))
    assert ElementTree.fromstring(pages.junit(quiet)).attrib | {"name": ""} == {
        "name": "",
        "tests": "2",
        "failures": "0",
        "errors": "0",
        "skipped": "1",
    }
    assert pages.github_annotations(quiet) == ["::notice title=evidence::evidence says"]
    worse = document(("evidence", False), ("inputs", False))
    assert ElementTree.fromstring(pages.junit(worse)).attrib["failures"] == "1"
    assert [q["severity"] for q in pages.code_quality(worse)] == ["info", "major"]


def test_an_odd_run_is_annotated() -> None:
    odd = {"run": "night 45", "what": "screw and hall", "says": "read as if exchanged"}
    (said,) = pages.github_annotations(document(("inputs", True), runs=[odd]))
    assert said == "::warning title=drift::Run night 45, screw and hall: read as if exchanged"
