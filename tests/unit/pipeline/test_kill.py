"""Killed at any instant, the next run completes and leaves what an uninterrupted one leaves, byte for byte."""

from __future__ import annotations

import os
import random
import shutil
import signal
import time
from pathlib import Path

import pytest

from errpipe.pipeline import runner, step
from errpipe.pipeline.spec import load_pipeline
from tests.unit.pipeline.stages_for_tests import STAGES, tree, write_stages

TEXT = """\
pipeline: 1
stages:
  - {kind: take, files: data}
  - {kind: scale, factor: 2, parts: 12}
  - {kind: scale, name: thirds, factor: 3, parts: 3}
  - {kind: sum}
"""


def run_in_a_child(where: Path, sets: list[str], kill_after: float | None) -> bool:
    """Run in a forked process, killed after so many seconds; True if the kill came before its end."""
    child = os.fork()
    if child == 0:
        try:
            runner.run(load_pipeline(where / "p.yaml", STAGES, sets=sets), where / "out")
            os._exit(0)
        except BaseException:
            os._exit(1)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def kill_in_a_loop(where: Path, times: int, seed: int) -> None:
    chance = random.Random(seed)
    write_stages(where, TEXT)
    start = time.perf_counter()
    run_in_a_child(where, [], None)
    whole = time.perf_counter() - start
    calm = tree(where / "out")
    shutil.rmtree(where / "out")
    killed = 0
    for _ in range(times):
        # every attempt wants something else, so that there is always work to be killed in
        sets = [f"scale.factor={chance.randint(1, 9)}", f"scale.parts={chance.randint(0, 14)}"]
        sets += [f"thirds.parts={chance.randint(0, 4)}"]
        killed += run_in_a_child(where, sets, chance.uniform(0.0, 1.1 * whole))
        if chance.random() < 0.2:
            run_in_a_child(where, [], None)
            assert tree(where / "out") == calm
    run_in_a_child(where, [], None)
    assert tree(where / "out") == calm
    assert killed > times / 8, "the kills came too late to mean anything"


def test_killed_a_few_times(tmp_path: Path) -> None:
    kill_in_a_loop(tmp_path, 12, seed=1)


def test_a_run_interrupted_between_its_records_leaves_nothing_behind(tmp_path: Path) -> None:
    """Killed while outputs were put in place, then wanted as before: nothing would have to run but for the journal."""
    write_stages(tmp_path, TEXT)
    run_in_a_child(tmp_path, [], None)
    calm = tree(tmp_path / "out")
    (tmp_path / "out/.errpipe/scale.json").write_text('["parts/0.json", "parts/99.json"]')
    (tmp_path / "out/scale/parts/99.json").write_text("[]")
    run_in_a_child(tmp_path, [], None)
    assert tree(tmp_path / "out") == calm


def test_only_outputs_and_the_last_record_wait_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A journal that lost its bytes in a power failure does not prevent the next run."""
    write_stages(tmp_path, TEXT)
    (tmp_path / "out/.errpipe").mkdir(parents=True)
    (tmp_path / "out/.errpipe/scale.json").touch()
    waits: list[int] = []
    monkeypatch.setattr(os, "fsync", waits.append)
    steps = runner.run(load_pipeline(tmp_path / "p.yaml", STAGES), tmp_path / "out")
    assert len(waits) == sum(len(step.written) for step in steps) + 1
    runner.run(load_pipeline(tmp_path / "p.yaml", STAGES), tmp_path / "out")
    assert len(waits) == sum(len(step.written) for step in steps) + 1


@pytest.mark.slow
def test_killed_a_hundred_times(tmp_path: Path) -> None:
    kill_in_a_loop(tmp_path, 100, seed=2)


def test_two_runs_on_one_out_take_turns(tmp_path: Path) -> None:
    write_stages(tmp_path, TEXT.replace("parts: 12", "parts: 3, pause: 0.1"))
    child = os.fork()
    if child == 0:
        runner.run(load_pipeline(tmp_path / "p.yaml", STAGES), tmp_path / "out")
        os._exit(0)
    while not (tmp_path / "out" / ".errpipe" / "work" / "scale").exists():
        time.sleep(0.005)
    heard: list[str] = []
    callbacks = step.Callbacks(waiting=lambda: heard.append("waits"))
    steps = runner.run(load_pipeline(tmp_path / "p.yaml", STAGES), tmp_path / "out", callbacks=callbacks)
    os.waitpid(child, 0)
    assert heard == ["waits"] and all(step.action == "fresh" for step in steps)
