"""What runs and what does not, and what is left behind."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from errpipe import stages
from errpipe.cli.app import main
from errpipe.errors import ConfigError, DataError, UsageError
from errpipe.pipeline import lock, runner
from errpipe.pipeline.spec import load_pipeline
from errpipe.pipeline.stage import Context
from tests.unit.pipeline.stages_for_tests import STAGES, TEXT, Scale, Take, tree, write_stages


@pytest.fixture
def where(tmp_path: Path) -> Path:
    write_stages(tmp_path)
    return tmp_path


def go(where: Path, *sets: str, **keys: Any) -> dict[str, list[str]]:
    """Run; stage name -> reasons, of those that ran."""
    steps = runner.run(load_pipeline(where / "p.yaml", STAGES, sets=sets), where / "out", **keys)
    return {step.name: list(step.reasons) for step in steps if step.action == "run"}


def would(where: Path, *sets: str, **keys: Any) -> dict[str, tuple[str, ...]]:
    """Plan; stage name -> (action, reasons...)."""
    steps = runner.plan(load_pipeline(where / "p.yaml", STAGES, sets=sets), where / "out", **keys)
    return {step.name: (step.action, *step.reasons) for step in steps if step.action != "fresh"}


def test_a_first_run_does_all_and_a_second_nothing(where: Path) -> None:
    assert go(where) == {name: ["has not run"] for name in ("take", "scale", "thirds", "sum")}
    assert json.loads((where / "out/sum/sum.json").read_text())["total"] == {"scale": 12.0, "thirds": 39.0}
    before, times = tree(where / "out"), {p: p.stat().st_mtime_ns for p in (where / "out").rglob("*.json")}
    assert go(where) == {} and would(where) == {}
    assert tree(where / "out") == before
    assert {p: p.stat().st_mtime_ns for p in (where / "out").rglob("*.json")} == times


def test_every_output_waits_for_the_disk_once_before_it_is_in_its_place(
    where: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced, moved, whole = [], [], (os.fsync, os.replace, os.unlink)

    def fsync(number: int) -> None:
        synced.append(os.fstat(number).st_ino)
        whole[0](number)

    def replace(source: Any, target: Any) -> None:
        if Path(target).suffix == ".json" and ".errpipe" not in Path(target).parts:
            moved.append((os.stat(source).st_ino, synced.count(os.stat(source).st_ino)))
        if Path(target).exists():
            forget(os.stat(target).st_ino)
        whole[1](source, target)

    def unlink(path: Any, **keys: Any) -> None:
        forget(os.lstat(path, **keys).st_ino)
        whole[2](path, **keys)

    def forget(gone: int) -> None:  # the number of a file that goes may be given to another one
        synced[:] = [number for number in synced if number != gone]

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace)
    monkeypatch.setattr(os, "unlink", unlink)
    go(where)
    assert len(moved) >= 4 and {times for _, times in moved} == {1}


def test_a_plan_of_nothing_writes_nothing(where: Path) -> None:
    assert [action for action, *_ in would(where).values()] == ["run"] * 4
    assert not (where / "out").exists()


def test_a_summary_is_there_also_when_nothing_runs(where: Path) -> None:
    go(where)
    steps = runner.run(load_pipeline(where / "p.yaml", STAGES), where / "out")
    assert [dict(step.summary) for step in steps][-1] == {"total": 51.0, "had_lines": True}


@pytest.mark.parametrize(
    "sets, reasons",
    [
        (["scale.factor=3"], {"scale": ["params.factor 2.0 -> 3.0"], "sum": ["input scale/parts/0.json changed"]}),
        (["thirds.parts=1"], {"thirds": ["params.parts 2 -> 1"], "sum": ["input thirds/parts/1.json is gone"]}),
        (["scale.pause=0.001"], {"scale": ["params.pause 0.0 -> 0.001"]}),  # same bytes out: sum need not run
        (
            ["sum.from={parts: [thirds, scale]}"],
            {"sum": ["from.parts[0] scale -> thirds", "from.parts[1] thirds -> scale"]},
        ),
    ],
)
def test_parameters_that_change(where: Path, sets: list[str], reasons: dict[str, list[str]]) -> None:
    go(where)
    planned = would(where, *sets)
    assert planned[next(iter(reasons))] == ("run", *reasons[next(iter(reasons))])
    assert go(where, *sets) == reasons
    assert go(where, *sets) == {}


def test_a_plan_says_what_depends_on_what(where: Path) -> None:
    go(where)
    assert would(where, "scale.factor=3") == {
        "scale": ("run", "params.factor 2.0 -> 3.0"),
        "sum": ("perhaps", "if scale brings something new"),
    }
    shutil.rmtree(where / "out")
    go(where, to="scale")
    assert list(would(where)) == ["thirds", "sum"]


def test_inputs_count_by_content(where: Path) -> None:
    go(where)
    os.utime(where / "data" / "a.txt")
    assert go(where) == {}
    (where / "data" / "a.txt").write_text("1\n5\n")
    assert go(where)["take"] == ["input data/a.txt changed"]
    (where / "data" / "c.txt").write_text("")
    assert go(where) == {"take": ["input data/c.txt is new"]}
    (where / "data" / "c.txt").unlink()
    (where / "data" / ".hidden").write_text("x")
    assert go(where) == {"take": ["input data/c.txt is gone"]}


def test_the_same_data_elsewhere_give_the_same_bytes(where: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    go(where)
    other = tmp_path_factory.mktemp("elsewhere") / "deep" / "down"
    write_stages(other)
    go(other)
    assert tree(where / "out") == tree(other / "out")
    shutil.move(where / "data", other / "moved" / "data")
    assert go(where, f"take.files={other}/moved/data") == {}
    assert not any(str(where).encode() in data or str(other).encode() in data for data in tree(where / "out").values())


def test_outputs_that_were_touched_by_hand(where: Path) -> None:
    go(where)
    before = tree(where / "out")
    (where / "out/scale/parts/0.json").unlink()
    (where / "out/thirds/parts/0.json").write_text("[]")
    (where / "out/thirds/notes.md").write_text("mine")
    assert go(where) == {"scale": ["output parts/0.json is missing"], "thirds": ["output parts/0.json was edited"]}
    assert tree(where / "out") == before | {"thirds/notes.md": b"mine"}


def test_a_lock_file_that_cannot_be_read_means_running_again(where: Path) -> None:
    go(where)
    before = tree(where / "out")
    for text in ("{", "[]", '{"errpipe_lock": 99, "stages": {}}', '{"errpipe_lock": 1, "stages": {"take": {"x": 1}}}'):
        (where / "out" / lock.LOCK).write_text(text)
        assert len(go(where)) == 4
        assert tree(where / "out") == before


def test_code_that_changed(where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    go(where)
    monkeypatch.setattr(Scale, "code_version", 2)
    assert go(where) == {"scale": ["code changed"], "thirds": ["code changed"]}


def test_to_and_force(where: Path) -> None:
    assert list(go(where, to="thirds")) == ["take", "thirds"]
    assert list(go(where)) == ["scale", "sum"]
    assert go(where, force=["take"]) == {"take": ["forced"]}
    with pytest.raises(UsageError, match=r"no stage 'thrids' .*Did you mean thirds"):
        go(where, to="thrids")


def test_a_stage_that_left_the_pipeline_takes_its_files_along(where: Path) -> None:
    go(where)
    (where / "out/thirds/parts/1.json").write_text("edited")
    (where / "p.yaml").write_text(TEXT.replace("  - {kind: scale, name: thirds, factor: 3, parts: 2}\n", ""))
    go(where, to="take")
    assert (where / "out/thirds/parts/0.json").exists()
    go(where)
    assert sorted(tree(where / "out/thirds")) == ["parts/1.json"]
    assert list(json.loads((where / "out" / lock.LOCK).read_text())["stages"]) == ["scale", "sum", "take"]


def test_a_stage_that_fails_leaves_its_outputs_and_those_before_it(where: Path) -> None:
    go(where)
    before = tree(where / "out")
    with pytest.raises(DataError, match="told to fail"):
        go(where, "scale.fails=true", "scale.factor=9")
    assert tree(where / "out") == before
    assert go(where) == {}


def test_an_input_that_changes_under_the_stage_is_not_recorded(where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(self: Take, context: Context) -> dict[str, Any]:
        context.write_text("lines.txt", "1\n")
        (where / "data" / "a.txt").write_text("now something else\n")
        return {}

    with monkeypatch.context() as patch:
        patch.setattr(Take, "run", run)
        with pytest.raises(DataError, match=r"data/a\.txt: changed while stage take was reading it"):
            go(where)
    assert lock.read_lock(where / "out") == {}


def test_a_promised_output_that_is_not_written_is_a_bug(where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Take, "outputs", lambda self: ("lines.txt", "more.txt"))
    with pytest.raises(RuntimeError, match=r"take did not write more\.txt"):
        go(where)


def test_a_stage_stays_in_its_folder(tmp_path: Path) -> None:
    for name in ("../x", "/x", "a/../../x"):
        with pytest.raises(DataError):
            Context(folder=tmp_path).write_text(name, "")


def test_an_out_folder_that_cannot_be(where: Path) -> None:
    pipeline = load_pipeline(where / "p.yaml", STAGES)
    with pytest.raises(UsageError, match="lies inside"):
        runner.run(pipeline, where / "data" / "out")
    with pytest.raises(UsageError, match="is a file"):
        runner.run(pipeline, where / "p.yaml")
    shutil.rmtree(where / "data")
    with pytest.raises(ConfigError, match=r"p\.yaml:4:25  stages\[0\]\.files: .*data does not exist"):
        runner.run(pipeline, where / "out")


def test_stages_side_by_side_give_the_same_bytes(where: Path) -> None:
    many = "".join(f"  - {{kind: scale, name: s{n}, factor: {n + 1}, pause: 0.15}}\n" for n in range(4))
    (where / "p.yaml").write_text(f"pipeline: 1\nstages:\n  - {{kind: take, files: data}}\n{many}  - {{kind: sum}}\n")
    heard: list[str] = []
    callbacks = runner.Callbacks(
        started=lambda s: heard.append(f"+{s.name}"), finished=lambda s: heard.append(f"-{s.name}")
    )
    go(where, jobs=4, callbacks=callbacks)
    assert set(heard[2:6]) == {"+s0", "+s1", "+s2", "+s3"}, "four stages of 0.15 s were not side by side"
    side_by_side = tree(where / "out")
    shutil.rmtree(where / "out")
    go(where)
    assert tree(where / "out") == side_by_side
    with pytest.raises(DataError, match="told to fail"):
        go(where, "s2.fails=true", jobs=4)


def test_progress_and_talk(where: Path) -> None:
    heard: list[str] = []
    callbacks = runner.Callbacks(
        started=lambda step: heard.append(f"+{step.name}"),
        progress=lambda name, fraction, text: heard.append(f"{name} {fraction} {text}"),
        finished=lambda step: heard.append(f"-{step.name} {len(step.written)}"),
    )
    runner.run(load_pipeline(where / "p.yaml", STAGES), where / "out", to="thirds", callbacks=callbacks)
    assert heard == ["+take", "-take 1", "+thirds", "thirds 0.5 part 1", "thirds 1.0 part 2", "-thirds 2"]


def test_inputs_of_one_name_are_distinguished(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder / "data").mkdir(parents=True)
        (tmp_path / folder / "data" / "x.txt").write_text(folder)
    labels = lock.label_inputs([tmp_path / "a" / "data", tmp_path / "b" / "data", tmp_path / "a" / "data" / "x.txt"])
    assert sorted(labels) == ["data (2)/x.txt", "data/x.txt", "x.txt"]


def test_readings_written_otherwise_make_no_other_table(tmp_path: Path) -> None:
    """A remark in the manifest and 1.50 for 1.5 are other bytes of the same recording: ingest alone runs."""
    site = tmp_path / "mill"
    assert main(["init", "--template", "dial-gauge", str(site)]) == 0
    assert main(["run", str(site / "pipeline.yaml"), "--out", str(site / "out"), "--to", "export"]) == 0
    before = (site / "out/export/table.ect").read_bytes()
    with (site / "recording/recording.yaml").open("a") as stream:
        stream.write("# by the night shift\n")
    rows = site / "recording/recording.csv"
    rows.write_text(rows.read_text().replace("24.99\n", "24.990\n", 1))
    steps = runner.run(load_pipeline(site / "pipeline.yaml", stages.STAGES), site / "out", to="export")
    assert [step.name for step in steps if step.action == "run"] == ["ingest"]
    assert (site / "out/export/table.ect").read_bytes() == before
