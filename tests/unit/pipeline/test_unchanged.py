"""A run with nothing to do is answered from a note, and only then."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from errpipe.pipeline import lock, runner, unchanged
from errpipe.pipeline.spec import load_pipeline
from errpipe.pipeline.step import NO_CALLBACKS, Step
from tests.unit.pipeline.stages_for_tests import STAGES, TEXT, Take, write_stages

SETS = ["scale.factor=2"]


@pytest.fixture
def where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_stages(tmp_path, TEXT.replace("files: data", "files: '${FOLDER:-data}'"))
    monkeypatch.chdir(tmp_path)
    pipeline = load_pipeline(Path("p.yaml"), STAGES, sets=SETS)
    runner.run(pipeline, Path("out"))
    unchanged.note(pipeline, Path("out"), SETS)
    return tmp_path


def answer(sets: list[str] = SETS) -> tuple[str, list[Step]] | None:
    return unchanged.steps(Path("p.yaml"), Path("out"), sets, NO_CALLBACKS)


def test_the_answer_is_that_of_a_run(where: Path) -> None:
    steps = runner.run(load_pipeline(Path("p.yaml"), STAGES, sets=SETS), Path("out"))
    assert answer() == ("three stages", steps)


def test_a_file_that_later_stages_do_not_read_is_no_input_of_theirs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as `ingest.json`: with it the note never answered, and every run looked at everything."""
    monkeypatch.setattr(Take, "file_types", {"about.json": "facts"})
    monkeypatch.setattr(Take, "outputs", lambda self: ("lines.txt", "about.json"))
    plain = Take.run
    monkeypatch.setattr(Take, "run", lambda self, c: (c.write_json("about.json", {}), plain(self, c))[1])
    write_stages(tmp_path)
    monkeypatch.chdir(tmp_path)
    pipeline = load_pipeline(Path("p.yaml"), STAGES)
    runner.run(pipeline, Path("out"))
    unchanged.note(pipeline, Path("out"), [])
    assert lock.read_lock(Path("out"))["scale"].inputs.keys() == {"take/lines.txt"}
    assert answer([]) is not None


def _append(name: str) -> Callable[[], object]:
    return lambda: Path(name).write_bytes(Path(name).read_bytes() + b"\n")


@pytest.mark.parametrize(
    "change",
    [
        _append("p.yaml"),
        _append("data/a.txt"),
        lambda: Path("data/c.txt").write_text("4\n"),
        lambda: Path("data/b.txt").unlink(),
        _append("out/sum/sum.json"),
        lambda: Path("out/sum/sum.json").unlink(),
        _append("out/errpipe.lock"),
        lambda: Path("out/errpipe.lock").unlink(),
        lambda: Path("out/.errpipe/sum.json").write_text("[]"),
        lambda: Path("out/.errpipe/unchanged.json").write_text("{}"),
        lambda: Path("out/.errpipe/unchanged.json").unlink(),
    ],
)
def test_any_change_sends_back_to_a_run(where: Path, change: Callable[[], object]) -> None:
    change()
    assert answer() is None


def test_other_options_environment_and_code_do_so_too(where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert answer(["scale.factor=3"]) is None
    monkeypatch.setenv("FOLDER", "data")
    assert answer() is None
    monkeypatch.delenv("FOLDER")
    assert answer() is not None
    monkeypatch.setattr(lock, "package_code", lambda: "edited")
    assert answer() is None
