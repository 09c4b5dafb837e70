"""One machine's history in parts that lie apart: one fit to all, the same bytes whoever passes over them."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe import jsonfile
from errpipe.cli.app import main
from errpipe.domain.manifest_text import manifest_text
from errpipe.domain.recording import Recording
from errpipe.formats import manifest_folder
from tests.unit.fitting.test_history import PIPELINE, log

ROWS, RUNS = 60_000, 12
LIST = [f"{{name: p{k}, set: [ingest.recording=/proc/self/cwd/p{k}]}}" for k in (1, 2, 3)]


def history() -> tuple[Recording, np.ndarray]:
    """A log with a pause before each of three parts of whole runs, and the part of each row."""
    recording = log(ROWS, runs=RUNS, seed=9)
    part = np.digitize(recording.run_codes(), (5, 7))
    return recording.with_columns({"t": recording.time() + 40_000.0 * part}, {}), part


def parts(where: Path) -> Path:
    """The parts as folders, and a fleet file for them."""
    where.mkdir()
    recording, part = history()
    manifest = manifest_text(recording.manifest.model_copy(update={"tables": ("t.parquet",)}))
    for k in (1, 2, 3):
        folder = where / f"p{k}"
        folder.mkdir()
        recording.frame[part == k - 1].to_parquet(folder / "t.parquet", index=False)
        (folder / "recording.yaml").write_text(manifest, "utf-8")
    (where / "pipeline.yaml").write_text(PIPELINE, "utf-8")
    text = f"fleet: 1\npipeline: pipeline.yaml\none_machine: true\nmachines: [{', '.join(LIST)}]\n"
    (where / "fleet.yaml").write_text(text, "utf-8")
    return where / "fleet.yaml"


def whole(out: Path) -> dict[str, bytes]:
    """The files of the joint fit and its validation."""
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in sorted((out / "whole").rglob("*")) if p.is_file()}


def test_parts_give_the_fit_of_the_whole(tmp_path: Path, monkeypatch: Any) -> None:
    file = parts(tmp_path / "s")
    monkeypatch.chdir(tmp_path / "s")
    assert main(["fleet", str(file), "--out", str(tmp_path / "a"), "--jobs", "1"]) == 0
    manifest_folder.write(history()[0], tmp_path / "s/all")
    keys = ("--set", "ingest.recording=all", "--set", "fit.rows_in_memory=10000")
    assert main(["run", str(tmp_path / "s/pipeline.yaml"), "--out", str(tmp_path / "b"), *keys]) == 0
    (a,), (b,) = (
        jsonfile.read(folder / "fit/error_model.json")["components"]
        for folder in (tmp_path / "a/whole", tmp_path / "b")
    )
    for key in ("rows", "rms_before", "rms_after", "rows_effective"):
        assert a[key] == pytest.approx(b[key], rel=1e-9)
    values = [[p["value"] for t in c["terms"] for p in t["parameters"]] for c in (a, b)]
    np.testing.assert_allclose(*values, rtol=1e-8)
    (a,), (b,) = (
        jsonfile.read(folder / "validate/validation.json")["components"]
        for folder in (tmp_path / "a/whole", tmp_path / "b")
    )
    assert a["verdict"] == b["verdict"] and a["rows"] == b["rows"]
    for key in ("rms_after", "bias_after", "worst_before", "worst_after"):
        np.testing.assert_allclose(*([g[key] for g in c["groups"]] for c in (a, b)), rtol=1e-8, atol=1e-9)


@contextlib.contextmanager
def cluster(folders: list[Path], file: Path) -> Iterator[str]:
    """A Dask scheduler, and a worker in each folder as its current one, started again where it is killed."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    ends = ["--scheduler-file", str(file), "--no-dashboard"]
    commands = [(["distributed.cli.dask_scheduler", "--port", "0", "--host", "127.0.0.1"], file.parent)]
    commands += [(["distributed.cli.dask_worker", "--nthreads", "1"], folder) for folder in folders]
    with contextlib.ExitStack() as stack:
        for command, folder in commands:
            child = subprocess.Popen(
                [sys.executable, "-m", *command, *ends],
                cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            stack.callback(child.wait)
            stack.callback(child.terminate)
        while not file.exists():
            time.sleep(0.1)
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        from distributed import Client

        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(len(folders), timeout=120)
        yield address


@pytest.mark.slow
def test_parts_on_workers_that_see_different_folders_and_one_killed(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    distributed = pytest.importorskip("distributed")
    file = parts(tmp_path / "s")
    monkeypatch.chdir(tmp_path / "s")
    assert main(["fleet", str(file), "--out", "/proc/self/cwd/out", "--jobs", "2"]) == 0
    here, first, second = (tmp_path / name for name in ("here", "first", "second"))
    for folder, names in ((here, ()), (first, ("p1", "p2")), (second, ("p3",))):
        folder.mkdir()
        for name in names:
            (tmp_path / "s" / name).rename(folder / name)
    monkeypatch.chdir(here)
    with cluster([first, second], tmp_path / "scheduler.json") as address:

        def kill_first() -> None:
            while not (first / "out/machines/p1/ingest").exists():
                time.sleep(0.02)
            with distributed.Client(address, set_as_default=False) as client:
                places = client.run(lambda: (os.getcwd(), os.getpid()))
            os.kill(next(pid for folder, pid in places.values() if folder == str(first)), signal.SIGKILL)
            killed.append(True)

        killed: list[bool] = []
        killer = threading.Thread(target=kill_first)
        killer.start()
        code = main(["fleet", str(file), "--out", "/proc/self/cwd/out", "--scheduler", address])
        killer.join()
        assert code == 0 and killed and whole(here / "out") == whole(tmp_path / "s/out")
        assert sorted(p.name for p in (here / "out").iterdir()) == ["whole"]
        assert sorted(p.name for p in (second / "out/machines").iterdir()) == ["p3"]
        (second / "p3/t.parquet").unlink()
        (second / "p3").rename(second / "elsewhere")
        capsys.readouterr()
        assert main(["fleet", str(file), "--out", "/proc/self/cwd/new", "--scheduler", address]) == 3
        said = capsys.readouterr().err
        assert "p3: no worker of the cluster can read it: /proc/self/cwd/p3 does not exist" in said
        assert not (here / "new").exists()
