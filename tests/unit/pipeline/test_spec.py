"""Reading pipeline files: links, paths, `--set`, and every problem with its place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

import pytest

from errpipe.errors import ConfigError, UsageError
from errpipe.pipeline.spec import load_pipeline, missing_inputs
from errpipe.pipeline.stage import Need
from tests.unit.pipeline.stages_for_tests import STAGES, Scale, Take, write_stages


def refusal(tmp_path: Path, stages: str, sets: list[str] | None = None) -> list[str]:
    """The lines of the refusal of a pipeline with these stages, without the folder."""
    write_stages(tmp_path, f"pipeline: 1\nstages:\n{stages}")
    with pytest.raises(ConfigError) as caught:
        load_pipeline(tmp_path / "p.yaml", STAGES, sets=sets or [])
    return str(caught.value).replace(f"{tmp_path}/", "").splitlines()


def test_a_stage_reads_the_nearest_earlier_one_of_the_kind(tmp_path: Path) -> None:
    text = """\
pipeline: 1
stages:
  - {kind: take, files: data}
  - {kind: scale}
  - {kind: take, name: again, files: data/a.txt}
  - {kind: scale, name: two}
  - {kind: scale, name: three, from: {lines: take}}
  - {kind: sum, from: {parts: [two, scale]}}
  - {kind: sum, name: all}
"""
    links = load_pipeline(write_stages(tmp_path, text), STAGES).links
    assert links["two"] == {"lines": ("again",)} and links["three"] == {"lines": ("take",)}
    assert links["sum"] == {"parts": ("two", "scale"), "lines": ("again",), "other": ()}
    assert links["all"] == {"parts": ("scale", "two", "three"), "lines": ("again",), "other": ("sum",)}


def test_relative_paths_start_at_the_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_stages(tmp_path)
    inner = tmp_path / "pipelines"
    inner.mkdir()
    text = "pipeline: 1\nroot: ..\nstages:\n  - {kind: take, files: '${WHERE:-data}'}\n"
    (inner / "p.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    (take,) = load_pipeline(Path("pipelines/p.yaml"), STAGES, environment={}).stages
    assert isinstance(take, Take) and take.files == Path("data")
    (take,) = load_pipeline(Path("pipelines/p.yaml"), STAGES, environment={"WHERE": "/far/away"}).stages
    assert isinstance(take, Take) and take.files == Path("/far/away") and take.parameters() == {"files": "away"}


def test_set_changes_a_key_of_a_stage(tmp_path: Path) -> None:
    path = write_stages(tmp_path)
    pipeline = load_pipeline(path, STAGES, sets=["thirds.factor=1e-3 mm", "title=other", "scale.parts=0x3"])
    assert pipeline.title == "other"
    assert pipeline.stage("thirds").parameters()["factor"] == 1.0
    assert pipeline.stage("scale").parameters()["parts"] == 3


@pytest.mark.parametrize(
    "text, message",
    [
        ("scales.factor=1", "no stage 'scales' (stages: take, scale, thirds, sum). Did you mean scale?"),
        ("scale.factor", "not of the form STAGE.key=value"),
        ("=1", "not of the form STAGE.key=value"),
        ("scale=1", "no stage 'scale'"),
        ("scale.factor.x=1", "stages[1].factor is the number 2, not a mapping"),
    ],
)
def test_a_set_that_names_nothing_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_pipeline(write_stages(tmp_path), STAGES, sets=[text])
    assert str(caught.value).startswith(f"--set {text}: ") and message in str(caught.value)


def test_a_set_value_may_be_nothing_and_a_path_may_not_be_empty(tmp_path: Path) -> None:
    stages = "  - {kind: take, files: data}\n  - {kind: scale}\n"
    assert sorted(refusal(tmp_path, stages, ["take.files=", "scale.factor=null", "scale.parts=~"])) == [
        "--set scale.factor=null  stages[1].factor: found nothing (a number is needed)",
        "--set scale.parts=~  stages[1].parts: found nothing (a whole number is needed)",
        "--set take.files=  stages[0].files: is empty (the name of a file or folder is needed)",
    ]


def test_a_set_value_is_refused_under_its_own_name(tmp_path: Path) -> None:
    stages = "  - {kind: take, files: data}\n  - {kind: scale}\n"
    assert refusal(tmp_path, stages, ["scale.factor=-1", "scale.facto=2"]) == [
        "--set scale.facto=2  stages[1].facto: unknown key"
        " (allowed: kind, name, from, factor, parts, pause, fails). Did you mean factor?",
        "--set scale.factor=-1  stages[1].factor: -1 is not above 0 um",
    ]


def test_links_that_cannot_be_made(tmp_path: Path) -> None:
    stages = """\
  - {kind: scale}
  - {kind: take, files: data}
  - {kind: scale}
  - {kind: scale, name: a, from: {lines: taek, line: take}}
  - {kind: scale, name: b, from: {lines: [take, take]}}
"""
    assert refusal(tmp_path, stages) == [
        "p.yaml:3:5  stages[0]: scale takes a lines, and no stage before it gives one",
        "p.yaml:5:5  stages[2]: a second stage named 'scale' (give one of them a name)",
        "p.yaml:6:42  stages[3].from.lines: no earlier stage 'taek' gives a lines (there are: take)."
        " Did you mean take?",
        "p.yaml:6:54  stages[3].from.line: scale has no such source (allowed: lines).",
        "p.yaml:7:42  stages[4].from.lines: names 2 stages (one is read)",
    ]


def test_a_name_that_is_no_folder_name_is_refused(tmp_path: Path) -> None:
    (line,) = refusal(tmp_path, "  - {kind: take, files: data, name: ../x}\n")
    assert line.startswith("p.yaml:3:37  stages[0].name: found '../x'")


def test_inputs_that_are_not_there_are_pointed_at(tmp_path: Path) -> None:
    text = "pipeline: 1\nstages:\n  - kind: take\n    files: ${D:-dat}\n"
    path = write_stages(tmp_path, text)
    pipeline = load_pipeline(path, STAGES)
    (problem,) = missing_inputs(pipeline, pipeline.stages)
    assert str(problem) == f"{path}:4:12  stages[0].files: {tmp_path}/dat does not exist. Did you mean {tmp_path}/data?"


def test_a_registry_of_one_stage_works(tmp_path: Path) -> None:
    path = write_stages(tmp_path, "pipeline: 1\nstages: [{kind: take, files: data}]\n")
    assert load_pipeline(path, (Take,)).stage("take").kind == "take"


def test_every_leaves_out_what_was_turned_into_another_one(tmp_path: Path) -> None:
    class Sort(Scale):
        """Parts in, parts out."""

        kind: Literal["sort"]
        takes: ClassVar[Mapping[str, Need]] = {"parts": Need("parts")}

    write_stages(
        tmp_path,
        "pipeline: 1\nstages:\n  - {kind: take, files: data}\n  - {kind: scale}\n  - {kind: scale, name: other}\n"
        "  - {kind: sort, from: {parts: scale}}\n  - {kind: sum}\n",
    )
    links = load_pipeline(tmp_path / "p.yaml", (*STAGES, Sort)).links
    assert links["sum"]["parts"] == ("other", "sort")


def test_an_output_that_nothing_reads_is_refused(tmp_path: Path) -> None:
    stages = "  - {kind: take, files: data}\n  - {kind: take, name: lost, files: data/a.txt}\n"
    assert refusal(tmp_path, stages + "  - {kind: scale, from: {lines: take}}\n") == [
        "p.yaml:4:5  stages[1]: its lines is not read, although a later stage takes one "
        "(leave the stage out, or write from: {lines: lost} in scale)"
    ]
    write_stages(
        tmp_path, f"pipeline: 1\nstages:\n{stages}  - {{kind: scale, from: {{lines: take}}}}\n  - {{kind: sum}}\n"
    )
    load_pipeline(tmp_path / "p.yaml", STAGES)  # the sum reads it
