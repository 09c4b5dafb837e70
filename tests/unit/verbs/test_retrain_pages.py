"""Pages of a retraining for CI."""

from __future__ import annotations

import errno
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

from errpipe.errors import VerifyError
from errpipe.verbs import _retrain_pages as pages
from errpipe.verbs import retrain as retrain_verb
from errpipe.verbs.retrain import _earlier_document

EMPTY: dict[str, list[Any]] = {key: [] for key in ("inputs", "residuals", "rms", "sizes", "changes", "runs")}


def document(*gates: tuple[str, bool], **drift: list[Any]) -> dict[str, Any]:
    judged = [{"name": n, "passed": p, "says": f"{n} says"} for n, p in gates]
    return {"title": "lathe 2", "gates": judged, "drift": EMPTY | drift, "narrower": []}


def test_a_night_without_findings_is_no_failure() -> None:
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


def test_pages_of_two_machines_are_distinguished() -> None:
    """In one report of GitLab findings of one fingerprint are one, and so are test cases of one class and name."""
    one = document(("inputs", False))
    other = one | {"title": "mill & lathe"}
    assert pages.code_quality(one)[0]["fingerprint"] != pages.code_quality(other)[0]["fingerprint"]
    assert [ElementTree.fromstring(pages.junit(d))[0].attrib["classname"] for d in (one, other)] == [
        "lathe 2",
        "mill & lathe",
    ]


def sensor(column: str, flagged: bool) -> dict[str, Any]:
    facts = {"flagged": flagged, "isolated": flagged, "healthy": False}
    return {"column": column, "since": "day 22", "size": 1.8, **facts}


def test_only_the_sensor_that_drifts_is_called_so() -> None:
    """The others leave it as it leaves them; and what is predicted by it is no sure sign of a changed machine."""
    size = {"component": "EXX", "since": "day 23", "factor": 0.5, "meaning": ""}
    seen = document(("sensors", False), inputs=[sensor("T_nut", True), sensor("T_bed", False)], sizes=[size])
    assert pages.github_annotations(seen)[1:] == [
        "::warning title=sensor::T_nut drifts since run day 22",
        "::warning title=sensor::T_bed disagrees with the others since run day 22",
    ]
    page = "\n".join(pages._drift_lines(seen["drift"]))
    assert "since run day 23: the machine changed, or T\\_nut reads wrong." in page


def test_an_outlying_run_is_annotated() -> None:
    odd = {"run": "night 45", "what": "screw and hall", "says": "read as if exchanged"}
    (said,) = pages.github_annotations(document(("inputs", True), runs=[odd]))
    assert said == "::warning title=drift::Run night 45, screw and hall: read as if exchanged"


def test_a_narrower_challenger_is_annotated() -> None:
    narrower = document(("inputs", True)) | {"narrower": ["T_nut: 19 to 25 degC"]}
    assert pages.github_annotations(narrower) == ["::warning title=narrower validity::T_nut: 19 to 25 degC"]


def test_a_look_that_judged_nothing_leaves_no_page_of_the_look_before(tmp_path: Path) -> None:
    """A file that was torn in the night: yesterday's pages would pass for today's."""
    for name in (pages.MARKDOWN, pages.JUNIT, pages.FIGURE):
        (tmp_path / name).write_text("promote", encoding="utf-8")
    pages.write_failure("axis", "night.csv:13  not UTF-8 text", tmp_path)
    assert ElementTree.fromstring((tmp_path / pages.JUNIT).read_text(encoding="utf-8")).attrib["errors"] == "1"
    assert "night.csv:13" in (tmp_path / pages.MARKDOWN).read_text(encoding="utf-8")
    assert not (tmp_path / pages.FIGURE).exists()


def test_a_full_disk_leaves_no_page_of_the_look_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its JUnit of yesterday said promote, and CI would show it as tonight's."""
    champion, out = tmp_path / "champion", tmp_path / "out"
    out.mkdir()
    (out / pages.JUNIT).write_text("promote", encoding="utf-8")

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(out / "run/ingest/recording.parquet"))

    monkeypatch.setattr(retrain_verb, "_decide", full)
    monkeypatch.setattr(pages.jsonfile, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        retrain_verb.retrain(SimpleNamespace(title="axis"), champion, out)  # type: ignore[arg-type]
    assert not (out / pages.JUNIT).exists()


def test_the_page_says_what_to_do_next() -> None:
    """A night without findings asks for nothing; a failed gate for something; a promotion names the challenger."""
    page = {"title": "", "e_value": 2.0, "e_value_needed": 20.0, "fitted_on_all": "", "fitted_since": None}
    said = {}
    for name, decision, gates in (
        ("quiet", "keep the champion", (("evidence", False), ("inputs", True))),
        ("failed", "keep the champion", (("evidence", False), ("inputs", False))),
        ("better", "promote", (("evidence", True), ("inputs", True))),
    ):
        text = pages.markdown(document(*gates) | page | {"decision": decision})
        said[name] = text.partition("**Next:** ")[2].partition("\n")[0]
        assert "reaches 20 in at most 0.05 of all histories" in text
    assert said["quiet"].startswith("nothing.") and "Correct each" in said["failed"] and "put `run`" in said["better"]


def test_a_damaged_document_of_the_look_before_says_what_it_holds(tmp_path: Path) -> None:
    for text in ("{", "[]", '{"retrain": 0}'):
        (tmp_path / "retrain.json").write_text(text, encoding="utf-8")
        with pytest.raises(VerifyError, match=r"put it back from a copy"):
            _earlier_document(tmp_path / "retrain.json")
