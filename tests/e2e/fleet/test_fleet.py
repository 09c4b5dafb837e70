"""`errpipe fleet`: many machines, in processes and on a Dask cluster, with failures, killed workers and pooled fits."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe import yamlfile
from errpipe.cli.app import main
from errpipe.domain.error_model import ErrorModel
from errpipe.pipeline import runner
from errpipe.verbs import fleet as fleet_verb
from errpipe.verbs import fleet_processes
from tests.e2e.retrain.test_retrain import PIPELINE, record
from tests.unit.fitting.test_history import two_years


def site(where: Path, machines: int, days: int = 6) -> Path:
    """A fleet of equal pipelines on machines whose days differ by name only, and one whose file is damaged."""
    where.mkdir(parents=True, exist_ok=True)
    (where / "axis.yaml").write_text(PIPELINE, encoding="utf-8")
    record(where / "recordings" / "m000", days)
    source = (where / "recordings/m000/recording.csv").read_text(encoding="utf-8").splitlines()
    manifest = (where / "recordings/m000/recording.yaml").read_text(encoding="utf-8")
    for k in range(1, machines):
        folder = where / "recordings" / f"m{k:03d}"
        folder.mkdir(parents=True)
        rng, rows = np.random.default_rng(k), [source[0]]
        own = 1.0 + 0.1 * rng.standard_normal()
        for line in source[1:]:
            *cells, last = line.split(",")
            rows.append(",".join([*cells, f"{own * float(last) + rng.normal(0, 0.3):.3f}"]))
        (folder / "recording.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
        (folder / "recording.yaml").write_text(manifest, encoding="utf-8")
    damaged = where / "recordings/m001/recording.csv"
    damaged.write_text(damaged.read_text(encoding="utf-8").replace("day 2,", "day 2,x", 1), encoding="utf-8")
    (where / "fleet.yaml").write_text(
        "fleet: 1\ntitle: hall 3\npipeline: axis.yaml\nrecordings: recordings\npool: true\n", encoding="utf-8"
    )
    return where / "fleet.yaml"


@pytest.mark.slow
def test_a_duplicate_recording_and_a_machine_of_reversed_sign_are_reported(tmp_path: Path) -> None:
    """Each alone is sound: only the fleet shows that one table would go to two machines, or drive the wrong way."""
    fleet = site(tmp_path, 8)
    places = {name: tmp_path / f"recordings/{name}/recording.csv" for name in ("m002", "m003", "m004")}
    places["m003"].write_bytes(places["m002"].read_bytes())
    head, *rows = places["m004"].read_text(encoding="utf-8").splitlines()
    turned = (row.rpartition(",") for row in rows)
    lines = [head, *(f"{left},{-float(value):.3f}" for left, _, value in turned), ""]
    places["m004"].write_text("\n".join(lines), encoding="utf-8")
    main(["fleet", str(fleet), "--out", str(tmp_path / "out"), "--jobs", "1"])
    document = json.loads((tmp_path / "out/fleet.json").read_text(encoding="utf-8"))
    assert document["suspicious"] == [
        "m002, m003: the same readings; one recording under several names?",
        "m004: EXX has the opposite sign of its type; was it declared correctly?",
    ]
    page = (tmp_path / "out/fleet.md").read_text(encoding="utf-8")
    assert all(text in page for text in document["suspicious"])


@pytest.mark.slow
def test_a_machine_of_a_fleet_is_retrained_with_its_folder_as_the_champion(tmp_path: Path) -> None:
    """m000 gets a new screw on day 12: it is followed on the runs since then. m002 has no new run: kept."""
    fleet = site(tmp_path, 3, days=12)
    main(["fleet", str(fleet), "--out", str(tmp_path / "out"), "--jobs", "1"])
    codes, documents = {}, {}
    for days in (13, 17, 21, 28, 36, 44):
        record(tmp_path / "recordings/m000", days, changed_from=12)
        for name in ("m000", "m002"):
            champion, out = tmp_path / "out/machines" / name, tmp_path / "retrain" / name
            recording = f'ingest.recording="{tmp_path / "recordings" / name}"'
            command = ["retrain", str(tmp_path / "axis.yaml"), "--champion", str(champion), "--out", str(out)]
            codes[name] = main([*command, "--set", recording])
            documents[name] = json.loads((out / "retrain.json").read_text(encoding="utf-8"))
        if codes["m000"] == 0:
            break
    assert codes == {"m000": 0, "m002": 4} and documents["m000"]["fitted_since"] in ("day 12", "day 13")
    assert documents["m002"]["runs"] == [] and not any(documents["m002"]["drift"].values())


def bytes_below(out: Path) -> dict[str, bytes]:
    """Every file of a fleet's run but times and locks of the system."""
    return {
        p.relative_to(out).as_posix(): p.read_bytes()
        for p in sorted(out.rglob("*"))
        if p.is_file() and ".errpipe" not in p.parts and p.name != "times.csv"
    }


def run(file: Path, out: Path, capsys: Any, *words: str) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = main(["fleet", str(file), "--out", str(out), *words, "--json"])
    return code, json.loads(capsys.readouterr().out)["result"]


@pytest.mark.slow
def test_a_failing_machine_or_killed_worker_does_not_affect_the_others(tmp_path: Path, capsys: Any) -> None:
    file = site(tmp_path / "site", 5)
    code, result = run(file, tmp_path / "a", capsys, "--jobs", "2")
    states = {r["name"]: r["state"] for r in result["machines"]}
    assert code == 4 and states.pop("m001") == "failed" and set(states.values()) == {"done"}
    assert result["machines"][0]["name"] == "m001" and "recording.csv" in result["machines"][0]["message"]
    left = [r["responses"]["EXX"]["rms_after"] for r in result["machines"][1:]]
    assert left == sorted(left, reverse=True) and all(t["peak_mb"] > 20 for t in result["times"].values())

    killed = threading.Event()

    def kill_one() -> None:
        for _ in range(600):
            time.sleep(0.05)
            if list((tmp_path / "b/machines").glob("*/.errpipe/*/*")):
                os.kill(_workers()[0], signal.SIGKILL)
                killed.set()
                return

    killer = threading.Thread(target=kill_one)
    killer.start()
    code, result = run(file, tmp_path / "b", capsys, "--jobs", "2")
    killer.join()
    assert killed.is_set() and code == 4
    assert max(t["attempts"] for t in result["times"].values()) >= 2
    assert bytes_below(tmp_path / "a") == bytes_below(tmp_path / "b")

    # resumed: what is done is not run again
    model = tmp_path / "a/machines/m002/fit/error_model.json"
    before = model.stat().st_mtime_ns
    assert run(file, tmp_path / "a", capsys, "--jobs", "1")[0] == 4 and model.stat().st_mtime_ns == before


def _workers() -> list[int]:
    """Copies of the fork server that this process has started, oldest first."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        try:
            if b"forkserver" in (entry / "cmdline").read_bytes():
                parents[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except (OSError, ValueError, IndexError):
            continue
    return sorted(pid for pid, parent in parents.items() if parents.get(parent) == os.getpid())


def test_a_machine_whose_worker_always_dies_is_failed_and_the_others_are_done(monkeypatch: Any) -> None:
    tasks = [("p", name, [], "o") for name in ("good", "deadly", "fine")]
    calls: list[str] = []

    def one_pool(batch: Any, count: int, attempts: dict[str, int]) -> Any:
        for task in batch:
            attempts[task[1]] += 1
            calls.append(task[1])
            if task[1] == "deadly":
                return
            yield task, {"name": task[1], "state": "done", "attempts": attempts[task[1]]}

    monkeypatch.setattr(fleet_processes, "_one_pool", one_pool)
    states = {r["name"]: r["state"] for r in fleet_processes.in_processes(tasks, 2)}
    assert states == {"good": "done", "deadly": "failed", "fine": "done"} and calls.count("deadly") == 3


def test_a_fleet_file_says_what_is_wrong(tmp_path: Path, capsys: Any) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text("fleet: 1\npipeline: axis.yaml\n", encoding="utf-8")
    assert main(["fleet", str(file), "--out", str(tmp_path / "o")]) == 2
    assert "`recordings` or `machines` is needed" in capsys.readouterr().err
    file.write_text("fleet: 1\npipeline: axis.yaml\nrecordings: r\nmachines: [{name: m9}]\n", encoding="utf-8")
    (tmp_path / "r").mkdir()
    assert main(["fleet", str(file), "--out", str(tmp_path / "o")]) == 2
    assert "holds no recording of m9" in capsys.readouterr().err
    (tmp_path / "r/m9").mkdir()  # a machine that sends nothing is not passed over: its run says so
    spec = yamlfile.load(file, fleet_verb.Fleet)
    assert [m.name for m in fleet_verb.machines_of(spec, tmp_path)] == ["m9"]
    (tmp_path / "axis.yaml").write_text(PIPELINE, encoding="utf-8")
    text = file.read_text(encoding="utf-8")
    file.write_text(text + "stage: ingst\n", encoding="utf-8")
    assert main(["fleet", str(file), "--out", str(tmp_path / "o")]) == 2
    assert "fleet.yaml: `stage` names" in (said := capsys.readouterr().err) and "Did you mean ingest?" in said
    file.write_text(text, encoding="utf-8")
    (tmp_path / "r/machine 7").mkdir()
    (tmp_path / "r/Fräse 3").mkdir()
    assert main(["fleet", str(file), "--out", str(tmp_path / "o")]) == 2
    assert "no name of a machine: Fräse 3, machine 7 (allowed" in capsys.readouterr().err


@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:1", "nonsense", "localhost:99999"])
def test_an_address_where_no_scheduler_is_ends_within_seconds(
    address: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client of Dask that gives up waited 20 s, and kept the process for 40 more."""
    pytest.importorskip("distributed")
    monkeypatch.setattr(fleet_verb, "CONNECTS", 0.2)
    begin = time.monotonic()
    assert main(["fleet", str(site(tmp_path, 2)), "--out", str(tmp_path / "o"), "--scheduler", address]) == 2
    assert "no Dask scheduler answers" in capsys.readouterr().err and time.monotonic() - begin < 15


def test_a_fleet_file_is_checked_with_its_pipeline(tmp_path: Path, capsys: Any) -> None:
    fleet = site(tmp_path, 2)
    assert main(["check", str(fleet)]) == 0
    assert capsys.readouterr().out == f"{fleet}: fleet, fine\n"
    (tmp_path / "axis.yaml").write_text(PIPELINE.replace("kind: validate", "kind: validat"), encoding="utf-8")
    assert main(["check", str(fleet)]) == 2
    assert "axis.yaml:" in capsys.readouterr().err


def test_names_and_folders_that_would_be_two_machines_are_refused(tmp_path: Path, capsys: Any) -> None:
    file = site(tmp_path, 2)
    assert main(["fleet", str(file), "--out", str(tmp_path / "recordings/out")]) == 2
    assert "would be read as a machine" in capsys.readouterr().err and not (tmp_path / "recordings/out").exists()
    file.write_text("fleet: 1\npipeline: axis.yaml\nmachines: [{name: m1}, {name: M1}]\n", encoding="utf-8")
    assert main(["fleet", str(file), "--out", str(tmp_path / "o")]) == 2
    assert "two machines have one name: m1" in capsys.readouterr().err
    file.write_text("fleet: 1\npipeline: axis.yaml\nrecordings: recordings\n", encoding="utf-8")
    (tmp_path / "recordings/M001").mkdir(exist_ok=True)
    if len(list((tmp_path / "recordings").iterdir())) == 3:  # the disk tells them apart
        assert main(["fleet", str(file), "--out", str(tmp_path / "o")]) == 2
        assert "two machines have one name: M001, m001" in capsys.readouterr().err


def test_a_wrong_key_of_the_first_machine_stops_no_other_one(tmp_path: Path, capsys: Any) -> None:
    site(tmp_path, 2)
    machines = "".join(f"  - {{name: {n}, set: [{n}.recording=recordings/m000]}}\n" for n in ("ingst", "ingest"))
    file = tmp_path / "two.yaml"
    file.write_text(f"fleet: 1\npipeline: axis.yaml\nmachines:\n{machines}", encoding="utf-8")
    code, result = run(file, tmp_path / "o", capsys, "--jobs", "1")
    assert code == 4 and {r["name"]: r["state"] for r in result["machines"]} == {"ingst": "failed", "ingest": "done"}
    file.write_text(file.read_text().replace("ingest.", "ingost."), encoding="utf-8")
    assert main(["fleet", str(file), "--out", str(tmp_path / "o")]) == 2  # of no machine: said once
    assert capsys.readouterr().err.count("no stage") == 1


def test_a_machine_that_fails_says_what_an_earlier_run_left_in_its_folder(tmp_path: Path) -> None:
    """Its table of before stays, and whoever reads its folder alone would take it for today's."""
    site(tmp_path, 2)
    task = [str(tmp_path / "axis.yaml"), "m", ["ingest.recording=recordings/m000"], str(tmp_path / "out")]
    done = fleet_processes.run_machine(*task)
    assert (done["state"], done["message"]) == ("done", "")
    damaged = ["ingest.recording=recordings/m001"]
    message = fleet_processes.run_machine(task[0], "new", damaged, task[3])["message"]
    assert "earlier" not in message and message.startswith("recordings/m001/")  # of no host
    left = {}
    for name, keys in {"ingest": damaged, "fit": [*task[2], "fit.components=[]"]}.items():
        left[name] = fleet_processes.run_machine(task[0], "m", keys, task[3])["message"].partition("; machines/m ")[2]
    read = tmp_path / "recordings/m000/recording.csv"  # a reading apart: ingest goes through, the fit has too few rows
    read.write_text("\n".join(read.read_text(encoding="utf-8").splitlines()[:4]) + "\n", encoding="utf-8")
    left["rows"] = fleet_processes.run_machine(*task)["message"].partition("; machines/m ")[2]
    assert left == {
        "ingest": "holds what an earlier run made: fit, ingest, validate",
        "fit": "holds what an earlier run made: fit, ingest, validate",
        "rows": "holds what an earlier run made: fit, validate",
    }
    killed = fleet_processes.failed_result(task, 3)["message"]
    assert "earlier run made: fit, ingest, validate" in killed


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="looks for processes as Linux lists them")
def test_ctrl_c_while_workers_import_is_answered_by_one_line(tmp_path: Path) -> None:
    file = site(tmp_path, 2, days=2)
    command = [sys.executable, "-m", "errpipe", "fleet", str(file), "--out", str(tmp_path / "out")]
    child = subprocess.Popen(
        command, cwd=Path(__file__).parents[3], start_new_session=True, stdout=subprocess.PIPE, text=True,
        stderr=subprocess.STDOUT, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    while not any(_is_fork_server_of(child.pid, entry) for entry in Path("/proc").glob("[0-9]*")):
        time.sleep(0.01)
        assert child.poll() is None
    time.sleep(0.1)  # it reads its own code, then what workers need
    os.killpg(child.pid, signal.SIGINT)
    assert child.communicate()[0] == "interrupted; the same command continues from here\n"
    assert child.returncode in (130, -signal.SIGINT)  # the latter where Python was in code made from text


def _is_fork_server_of(parent: int, entry: Path) -> bool:
    try:
        line, stat = (entry / "cmdline").read_bytes(), (entry / "stat").read_text()
    except OSError:  # it has ended
        return False
    return b"forkserver" in line and int(stat.rpartition(")")[2].split()[1]) == parent


def test_the_largest_machine_is_begun_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begun last, it would keep one worker when all others idle; the report stays in the order of names."""
    file, begun = site(tmp_path, 4), []
    record(tmp_path / "recordings/m002", 9)

    def processes(tasks: Any, jobs: int) -> Any:
        begun.extend(task[1] for task in tasks)
        return (fleet_processes.failed_result(task, 3) for task in tasks)

    monkeypatch.setattr(fleet_processes, "in_processes", processes)
    document = fleet_verb.fleet(file, tmp_path / "out", 2)
    assert begun[0] == "m002" and [r["name"] for r in document["machines"]] == ["m000", "m001", "m002", "m003"]


def test_a_full_disk_is_no_internal_error_of_a_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site(tmp_path, 2)
    task = [str(tmp_path / "axis.yaml"), "m", ["ingest.recording=recordings/m000"], str(tmp_path / "out")]

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", f"{task[3]}/machines/m/ingest/recording.parquet")

    monkeypatch.setattr(runner, "run", full)
    said = fleet_processes.run_machine(*task)
    assert (said["state"], said["message"]) == (
        "failed",
        "OUT/machines/m/ingest/recording.parquet: no space left on device",
    )


@pytest.mark.slow
def test_machines_on_a_dask_cluster_with_a_worker_killed(tmp_path: Path, capsys: Any) -> None:
    """30 machines; FLEET_MACHINES=200 in the environment takes as many (about 10 minutes on two cores)."""
    distributed = pytest.importorskip("distributed")
    number = int(os.environ.get("FLEET_MACHINES", "30"))
    file = site(tmp_path / "site", number, days=4)
    code, local = run(file, tmp_path / "a", capsys, "--jobs", "2")
    assert code == 4 and [r["state"] for r in local["machines"]].count("done") == number - 1
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:

        def kill_one() -> None:
            while len(list((tmp_path / "b/machines").glob("*/errpipe.lock"))) < 5:
                time.sleep(0.2)
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

        killer = threading.Thread(target=kill_one)
        killer.start()
        code, spread = run(file, tmp_path / "b", capsys, "--scheduler", cluster.scheduler_address)
        killer.join()
    assert code == 4 and spread["machines"] == local["machines"]
    assert bytes_below(tmp_path / "a") == bytes_below(tmp_path / "b")


@pytest.mark.slow
def test_partitions_that_only_the_workers_can_read(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    """Two years of logs below the workers' current folder, fitted in batches on Dask; nothing of them lies here."""
    pytest.importorskip("distributed")
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir(), here.mkdir()
    two_years(there, 150_000)
    (there / "pipeline.yaml").rename(here / "pipeline.yaml")
    machine = "{name: m0, set: [ingest.recording=/proc/self/cwd/raw]}"
    (here / "fleet.yaml").write_text(f"fleet: 1\npipeline: pipeline.yaml\nmachines: [{machine}]\n", encoding="utf-8")
    monkeypatch.chdir(here)
    code, result = run(here / "fleet.yaml", tmp_path / "nothing", capsys, "--jobs", "1")
    assert code == 4 and "/proc/self/cwd/raw" in result["machines"][0]["message"]
    with cluster_in(there) as address:
        code, far = run(here / "fleet.yaml", tmp_path / "a", capsys, "--scheduler", address)
    (judged,) = far["machines"][0]["responses"].values()
    assert code == 0 and judged["rms_after"] < judged["rms_before"] / 5
    monkeypatch.chdir(there)
    assert run(here / "fleet.yaml", tmp_path / "b", capsys, "--jobs", "1")[0] == 0
    assert bytes_below(tmp_path / "a") == bytes_below(tmp_path / "b")


@contextmanager
def cluster_in(folder: Path) -> Iterator[str]:
    """A Dask scheduler and a worker whose current folder is another than ours."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    file = folder.parent / "scheduler.json"
    scheduler = ["distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--host", "127.0.0.1"]
    worker = ["distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard"]
    with contextlib.ExitStack() as stack:
        for command in (scheduler, worker):
            child = subprocess.Popen(
                [sys.executable, "-m", *command, "--scheduler-file", str(file)],
                cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            stack.callback(child.wait)
            stack.callback(child.terminate)
        for _ in range(600):
            if file.exists():
                break
            time.sleep(0.1)
        yield json.loads(file.read_text(encoding="utf-8"))["address"]


def test_six_machines_and_what_they_borrow_from_their_type(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pooled parameters stand in a model of each machine; a bad machine is the first of the report."""

    def in_this_process(tasks: Any, jobs: int) -> Any:
        return (fleet_processes.run_machine(*task) for task in tasks)

    monkeypatch.setattr(fleet_processes, "in_processes", in_this_process)
    old = tmp_path / "o/pooled/m001/error_model.json"  # of a run in which it was sound
    old.parent.mkdir(parents=True)
    old.write_text("{}", encoding="utf-8")
    code, result = run(site(tmp_path / "site", 6, days=4), tmp_path / "o", capsys)
    assert not old.exists()
    assert code == 4 and [r["name"] for r in result["machines"] if r["state"] != "done"] == ["m001"]
    assert (tmp_path / "o/fleet.md").read_text(encoding="utf-8").count("| m0") == 6
    (kind,) = result["types"]
    pooled = kind["responses"]["EXX"]
    assert len(pooled["machines"]) == 5
    for name in pooled["machines"]:
        own = ErrorModel.model_validate_json((tmp_path / f"o/machines/{name}/fit/error_model.json").read_text())
        new = ErrorModel.model_validate_json((tmp_path / f"o/pooled/{name}/error_model.json").read_text())
        a, b = ([p.value for t in m.components[0].terms for p in t.parameters] for m in (own, new))
        assert b == pytest.approx(pooled["pooled"][name]) and a != b
