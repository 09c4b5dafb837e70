"""Pipes, devices, links, names that lead out of their folder, full disks: refused with a message, nothing harmed."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from errpipe import files, jsonfile
from errpipe.errors import VerifyError
from errpipe.tables import ect
from tests.hostile.command_line import PIPELINE, command, process, recording_folder
from tests.unit.targets import machines

LEAVING = ["../x", "..", "/etc/x", "a/../../x", "a\\..\\x", "C:x", "", " ", "a\0b", "a\nb", "/", "a//etc/x"]


@pytest.mark.parametrize("name", LEAVING)
def test_a_name_that_leaves_its_folder_is_refused(name: str, tmp_path: Path) -> None:
    assert not files.stays_inside(name)
    with pytest.raises(VerifyError):
        files.inside(tmp_path, name, VerifyError)


def test_a_link_that_leaves_its_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "away").symlink_to(tmp_path)
    with pytest.raises(VerifyError, match="link"):
        files.inside(tmp_path / "out", "away/x", VerifyError)
    assert files.inside(tmp_path / "out", "here/x..y/.z", VerifyError)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    recording_folder(tmp_path / "rec")
    (tmp_path / "p.yaml").write_text(PIPELINE)
    (tmp_path / "precious.txt").write_text("precious")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["../../precious.txt", "../precious.txt", "/precious.txt"])
def test_a_lock_file_that_lists_a_foreign_file_deletes_nothing(project: Path, name: str, capsys: Any) -> None:
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 0
    lock = json.loads((project / "out/errpipe.lock").read_text())
    digest = jsonfile.fingerprint_bytes(b"precious")
    name = name.replace("/precious", f"{project}/precious") if name.startswith("/") else name
    for stage in (lock["stages"]["clean"], lock["stages"].setdefault("gone", lock["stages"]["clean"])):
        stage["outputs"][name] = digest
    (project / "out/errpipe.lock").write_text(json.dumps(lock))
    code, text = command("run", "p.yaml", "--out", "out", capsys=capsys)
    assert code == 6 and "outside the folder" in text
    assert (project / "precious.txt").read_text() == "precious"


def test_a_stage_of_the_lock_that_is_a_foreign_folder_deletes_nothing(project: Path, capsys: Any) -> None:
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 0
    lock = json.loads((project / "out/errpipe.lock").read_text())
    lock["stages"][".."] = {
        **lock["stages"]["clean"],
        "outputs": {"precious.txt": jsonfile.fingerprint_bytes(b"precious")},
    }
    (project / "out/errpipe.lock").write_text(json.dumps(lock))
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 6
    assert (project / "precious.txt").exists()


def test_a_journal_that_lists_a_foreign_file_deletes_nothing(project: Path, capsys: Any) -> None:
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 0
    (project / "out/.errpipe/clean.json").write_text(json.dumps(["../../precious.txt"]))
    code, text = command("run", "p.yaml", "--out", "out", capsys=capsys)
    assert code == 6 and "outside the folder" in text
    assert (project / "precious.txt").exists()


def test_a_stage_folder_that_is_a_link_elsewhere_is_not_written(project: Path, capsys: Any) -> None:
    (project / "elsewhere").mkdir()
    (project / "out").mkdir()
    (project / "out/clean").symlink_to(project / "elsewhere")
    code, text = command("run", "p.yaml", "--out", "out", capsys=capsys)
    assert code == 6 and "link" in text
    assert list((project / "elsewhere").iterdir()) == []


def test_scratch_that_is_a_link_elsewhere_is_not_emptied(project: Path, capsys: Any) -> None:
    (project / "elsewhere" / "work").mkdir(parents=True)
    (project / "elsewhere" / "work" / "precious.txt").write_text("precious")
    (project / "out").mkdir()
    (project / "out/.errpipe").symlink_to(project / "elsewhere")
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 6
    assert (project / "elsewhere" / "work" / "precious.txt").exists()


@pytest.mark.parametrize("name", ["../precious.txt", "linuxcnc_screw/../../precious.txt", "/etc/hostname"])
def test_an_export_that_names_a_foreign_file_is_not_verified(project: Path, name: str, capsys: Any) -> None:
    ect.write(machines.too_long_at_plus_x(), project / "t.ect")
    assert command("export", "t.ect", "--target", "linuxcnc_screw", "--out", "e", capsys=capsys)[0] == 0
    assert command("verify", "e", capsys=capsys)[0] == 0
    sound = json.loads((project / "e/export.json").read_text())
    listed = {**sound, "files": [*sound["files"], {**sound["files"][0], "file": name}]}
    summed = {**sound, "sha256": {**sound["sha256"], name: jsonfile.fingerprint_bytes(b"precious")}}
    for changed in (listed, summed):
        (project / "e/export.json").write_text(json.dumps(changed))
        code, text = command("verify", "e", capsys=capsys)
        assert code == 6 and name in text, text


@pytest.mark.parametrize(
    "change",
    [
        {"files": None},
        {"files": [3]},
        {"files": [{"error": "0"}]},
        {"files": [{"file": 7, "error": "0"}]},
        {"files": [{"file": "linuxcnc_screw/x.comp", "error": "0", "losses": [{"rms_um": 1}]}]},
        {"files": [{"file": "linuxcnc_screw/x.comp", "error": "0", "losses": [{"axis": "X", "rms_um": "a"}]}]},
        {"sha256": []},
        {"sha256": {"table.ect": 1}},
    ],
)
def test_an_export_list_of_other_types_is_a_message(project: Path, change: dict, capsys: Any) -> None:
    ect.write(machines.too_long_at_plus_x(), project / "t.ect")
    assert command("export", "t.ect", "--target", "linuxcnc_screw", "--out", "e", capsys=capsys)[0] == 0
    sound = json.loads((project / "e/export.json").read_text())
    (project / "e/export.json").write_text(json.dumps(sound | change))
    code, text = command("verify", "e", capsys=capsys)
    assert code == 6 and "export.json" in text, text


@pytest.mark.parametrize(
    "lock", ["[]", "{", '{"errpipe_lock": 1, "stages": {"clean": {"kind": 3}}}', "[" * 100_000, "\xff"]
)
def test_a_lock_file_that_is_none_counts_as_none(project: Path, lock: str, capsys: Any) -> None:
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 0
    (project / "out/errpipe.lock").write_text(lock, encoding="latin-1")
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 0


# ---------------------------------------------------------------- what would be read for ever


def special(path: Path, what: str) -> Path:
    """A named pipe, a link to a device that never ends, a socket, or a file of a terabyte of nothing."""
    path.unlink(missing_ok=True)
    match what:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "socket":
            with socket.socket(socket.AF_UNIX) as server:
                server.bind(os.path.relpath(path))
        case _:
            with path.open("wb") as stream:
                stream.truncate(1 << 40)
    return path


VERBS = [
    "check @", "whatis @", "show @", "verify @", "plan @", "run @", "fleet @ --out o", "synthesis @", "place @",
    "eval @ --at x=1", "export @ --target iec_st --out o", "compare-targets @", "import @ --out o --yes",
    "predict @ rec --out o.csv", "diagnose rec --against @ --out o", "verify-signature t.ect --public-key @",
    "correct @ --table t.ect --start 0,0,0 --out o.ngc", "correct p.yaml --table @ --start 0,0,0 --out o.ngc",
]  # fmt: skip


@pytest.mark.parametrize("what", ["pipe", "device", "socket", "terabyte"])
def test_no_verb_waits_for_what_is_no_file(what: str, project: Path, capsys: Any) -> None:
    """In this process, which an alarm ends where a verb waits: no verb takes what is none of its files."""
    ect.write(machines.too_long_from_above(), project / "t.ect")
    path = special(project / "special.csv", what)
    signal.alarm(120)
    try:
        for words in VERBS:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            code, text = command(*words.replace("@", path.name).split(), capsys=capsys)
            assert code in (2, 3, 6) and path.name in text and "option" not in text, (words, code, text)
            assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + 500_000, words  # kB
    finally:
        signal.alarm(0)


@pytest.mark.parametrize("what", ["pipe", "device", "socket", "terabyte"])
def test_no_verb_waits_for_a_table_of_a_recording(what: str, project: Path, capsys: Any) -> None:
    special(project / "rec/rows.csv", what)
    signal.alarm(60)
    try:
        for words in ("check rec", "check p.yaml", "run p.yaml --out o"):
            code, text = command(*words.split(), capsys=capsys)
            assert (code in (2, 3) and "rows.csv" in text) or "recording.yaml:2:10" in text, (words, code, text)
    finally:
        signal.alarm(0)


@pytest.mark.parametrize("what", ["pipe", "device"])
def test_a_pipe_or_a_device_in_a_recording_folder_is_refused(project: Path, what: str, capsys: Any) -> None:
    special(project / "rec/special", what)
    code, text = command("run", "p.yaml", "--out", "out", capsys=capsys)
    assert code == 3 and "special: is a" in text


def test_a_folder_that_links_to_itself_ends(project: Path, capsys: Any) -> None:
    (project / "rec/again").symlink_to(project / "rec")
    (project / "rec/up").symlink_to(project)
    assert command("run", "p.yaml", "--out", project.parent / f"{project.name}-out", capsys=capsys)[0] == 0


@pytest.mark.slow
def test_a_recording_folder_of_a_hundred_thousand_files_ends(project: Path, capsys: Any) -> None:
    for number in range(100_000):
        (project / "rec" / f"{number}.txt").touch()
    began = time.process_time()
    code, text = command("run", "p.yaml", "--out", "out", capsys=capsys)
    assert code in (0, 3) and time.process_time() - began < 60.0, text


# ---------------------------------------------------------------- disks that are full


def test_a_full_disk_is_a_message_and_keeps_what_was_there(project: Path, capsys: Any) -> None:
    assert command("run", "p.yaml", "--out", "out", "--to", "ingest", capsys=capsys)[0] == 0
    before = {p: p.read_bytes() for p in (project / "out").rglob("*") if p.is_file()}
    recording_folder(project / "rec", rows=4000)
    done = process(["run", "p.yaml", "--out", "out"], limits={resource.RLIMIT_FSIZE: 4096})
    assert done.returncode == 2 and "file too large" in done.stderr, done.stderr
    assert {p: p.read_bytes() for p in before} == before
    assert not list((project / "out").rglob("*.tmp"))
    assert command("run", "p.yaml", "--out", "out", capsys=capsys)[0] == 0


def test_what_a_killed_process_left_of_a_file_goes_with_the_next_one(tmp_path: Path) -> None:
    """Killed runs of `correct` left a hidden file each, as long as the program, for ever."""
    lines = "import os, pathlib, signal, sys", "from errpipe import files"
    lines += ("with files.whole(pathlib.Path(sys.argv[1])) as stream:", "    os.kill(os.getpid(), signal.SIGKILL)")
    for name in ("p [1].ngc", "p [1].ngc", "q.ngc"):
        subprocess.run([sys.executable, "-c", "\n".join(lines), str(tmp_path / name)], check=False)
    assert len(list(tmp_path.glob(".*.tmp"))) == 2
    with files.whole(tmp_path / "p [1].ngc") as first:
        with files.whole(tmp_path / "p [1].ngc") as second:
            assert len(list(tmp_path.glob(".p*.tmp"))) == 2  # the other one is being written
            second.write(b"second")
        first.write(b"first")
    assert (tmp_path / "p [1].ngc").read_bytes() == b"first"
    assert [p.name[:6] for p in tmp_path.glob(".*.tmp")] == [".q.ngc"]


def test_standard_output_that_is_full_is_a_message(project: Path) -> None:
    with open("/dev/full", "wb") as full:
        done = process(["check", "p.yaml"], stdout=full)
    assert done.returncode == 2 and "no space left" in done.stderr and "internal" not in done.stderr


# ---------------------------------------------------------------- JSON


@pytest.mark.parametrize(
    "text, word",
    [
        ("[" * 100_000, "nested"),
        ("1" * 5000, "exceeds the limit"),
        ("{", "not JSON"),
        ("\xff", "UTF-8"),
        (json.dumps({str(k): 1 for k in range(100_001)}), "an object of 100001 keys"),
        (json.dumps({"table": 2, "inputs": [{}] * 100_001}), "more than 100000 objects"),
    ],
    ids=["deep", "digits", "cut", "bytes", "keys", "objects"],
)
def test_hostile_json_is_a_message(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "x.json").write_text(text, encoding="latin-1")
    with pytest.raises(VerifyError, match=word):
        jsonfile.read(tmp_path / "x.json")


def test_a_table_or_model_of_any_size_is_bounded(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "t.ect"
    with open(path, "wb") as stream:
        stream.truncate(1 << 40)  # a hole of a terabyte
    code, text = command("eval", path, "--at", "x=1", capsys=capsys)
    assert code == 6 and "at most" in text
