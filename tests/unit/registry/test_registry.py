"""The registry loses nothing, hides nothing, and refuses whatever was touched; signatures are minisign's."""

from __future__ import annotations

import hashlib
import os
import random
import resource
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from errpipe.cli.app import main
from errpipe.errors import DataError, GateError, UsageError, VerifyError
from errpipe.registry import minisign
from errpipe.registry.store import Registry
from errpipe.tables import ect
from tests.hostile.registry import campaign
from tests.unit.registry.command_line import filled, run
from tests.unit.targets import machines


def test_what_was_on_machine_7_and_why(where: Path, capsys: Any) -> None:
    reg = where / "reg"
    for day, table in (("2026-01-10", "one.ect"), ("2026-03-01", "two.ect")):
        words = ("promote", reg, "7", where / table, "--why", f"recorded on {day}", "--time", day)
        assert run(where, *words, capsys=capsys)[0] == 0
    words = ("rollback", reg, "7", "--why", "worse in the cold", "--time", "2026-03-05", "--out", where / "back.ect")
    assert run(where, *words, capsys=capsys)[0] == 0
    assert (where / "back.ect").read_bytes() == (where / "one.ect").read_bytes()
    _, document = run(where, "log", reg, "7", capsys=capsys)
    assert [e["action"] for e in document["result"]["entries"]] == ["promote", "promote", "rollback"]
    _, document = run(where, "log", reg, "7", "--at", "2026-03-03", capsys=capsys)
    (entry,) = document["result"]["entries"]
    assert entry["number"] == 2 and entry["why"] == "recorded on 2026-03-01"
    _, document = run(where, "log", reg, "--file", where / "one.ect", capsys=capsys)
    assert [e["number"] for e in document["result"]["entries"]] == [1, 3]
    ect.write(machines.bent(), where / "unrecorded.ect")
    assert run(where, "log", reg, "--file", where / "unrecorded.ect", capsys=capsys)[0] == 6


def test_a_table_of_another_axis_or_machine_does_not_replace_one_unasked(where: Path, capsys: Any) -> None:
    """A controller runs one table: that of Y alone in place of X's would end the compensation of X."""
    sound = machines.too_long_at_plus_x()
    other_axis = [o.model_copy(update={"axis": "Y"}) for o in sound.outputs]
    ect.write(sound.model_copy(update={"outputs": other_axis}), where / "y.ect")
    ect.write(sound.model_copy(update={"machine": "mill 3"}), where / "three.ect")
    ect.write_json(sound.model_copy(update={"machine": "mill 4"}), where / "four.json")
    ect.write_json(sound.model_copy(update={"machine": ""}), where / "one.json")
    first = ("promote", where / "reg", "7", where / "one.json", "--why", "the first")
    assert run(where, *first, capsys=capsys)[0] == 0
    code, document = run(where, "promote", where / "reg", "7", where / "y.ect", "--why", "Y measured", capsys=capsys)
    assert code == 4
    assert "(axis Y, in mm), the one on record" in document["error"]["message"]
    assert run(where, "promote", where / "reg", "7", where / "three.ect", "--why", "moved", capsys=capsys)[0] == 0
    code, document = run(where, "promote", where / "reg", "7", where / "four.json", "--why", "moved", capsys=capsys)
    assert code == 4 and "made for 'mill 4', the one on record for 'mill 3'" in document["error"]["message"]
    words = ("promote", where / "reg", "7", where / "y.ect", "--why", "X has glass scales now", "--other-outputs")
    assert run(where, *words, capsys=capsys)[0] == 0
    assert len(Registry(where / "reg", minisign.read_public(where / "keys/errpipe.pub")).history("7")) == 3


def test_a_table_that_corrects_in_other_units_does_not_replace_one_unasked(where: Path, capsys: Any) -> None:
    """A controller that takes mm would go 1000 times too far by a table whose corrections are in um."""
    sound = machines.too_long_at_plus_x()
    microns = [o.model_copy(update={"correction_unit": "um"}) for o in sound.outputs]
    ect.write(sound.model_copy(update={"outputs": microns}), where / "um.ect")
    assert run(where, "promote", where / "reg", "7", where / "one.ect", "--why", "first", capsys=capsys)[0] == 0
    words = ("promote", where / "reg", "7", where / "um.ect", "--why", "another export")
    code, document = run(where, *words, capsys=capsys)
    assert code == 4 and "in um), the one on record" in document["error"]["message"]
    assert run(where, *words, "--other-outputs", capsys=capsys)[0] == 0


def test_a_table_of_another_machine_of_the_registry_is_not_promoted_unasked(where: Path, capsys: Any) -> None:
    """The first table of a machine has none before it to be compared with."""
    for name in ("mill-3", "mill-4"):
        ect.write(machines.too_long_at_plus_x().model_copy(update={"machine": name}), where / f"{name}.ect")
    words = ("--why", "new")
    assert run(where, "promote", where / "reg", "mill-4", where / "mill-4.ect", *words, capsys=capsys)[0] == 0
    code, document = run(where, "promote", where / "reg", "mill-3", where / "mill-4.ect", *words, capsys=capsys)
    assert code == 4 and "was made for mill-4, which this registry has too" in document["error"]["message"]
    assert run(where, "promote", where / "reg", "mill-4-X", where / "mill-4.ect", *words, capsys=capsys)[0] == 0
    assert run(where, "promote", where / "reg", "mill-3", where / "mill-3.ect", *words, capsys=capsys)[0] == 0
    again = ("promote", where / "reg", "mill-5", where / "mill-4.ect", *words)
    assert run(where, *again, capsys=capsys)[0] == 4 and run(where, *again, "--other-outputs", capsys=capsys)[0] == 0


def test_a_table_that_was_changed_is_named_by_its_entry(where: Path, capsys: Any) -> None:
    reg = where / "reg"
    for name in ("one.ect", "two.ect"):
        assert run(where, "promote", reg, "7", where / name, "--why", name, capsys=capsys)[0] == 0
    digest = hashlib.sha256((where / "one.ect").read_bytes()).hexdigest()
    place = reg / "objects" / digest[:2] / digest
    place.chmod(0o644)
    place.write_bytes(place.read_bytes()[:-1] + b"x")
    for words in (("log", reg, "7"), ("rollback", reg, "7", "--why", "bad")):
        code, document = run(where, *words, capsys=capsys)
        assert code == 6 and "machine 7, table of entry 1: " in document["error"]["message"]


def test_a_folder_that_is_no_recording_is_called_what_it_is(where: Path, capsys: Any) -> None:
    """A registry and a run folder both lacked a `recording.yaml`."""
    assert run(where, "promote", where / "reg", "7", where / "one.ect", "--why", "new", capsys=capsys)[0] == 0
    assert main(["whatis", str(where / "reg")]) == 3 and "a registry (`errpipe log`" in capsys.readouterr().err
    (where / "out").mkdir()
    (where / "out/errpipe.lock").write_text('{"errpipe_lock": 1, "stages": {}}', encoding="utf-8")
    assert main(["whatis", str(where / "out")]) == 0 and "lock of a run" in capsys.readouterr().out


def test_of_a_json_twin_what_a_controller_loads_is_on_record(where: Path, capsys: Any) -> None:
    """`rollback --out table.ect` gave JSON back, which no controller reads."""
    ect.write_json(machines.too_long_at_plus_x(), where / "one.json")
    for name in ("one.json", "two.ect"):
        words = ("promote", where / "reg", "7", where / name, "--why", "measured")
        assert run(where, *words, capsys=capsys)[0] == 0
    words = ("rollback", where / "reg", "7", "--why", "worse", "--out", where / "back.ect")
    assert run(where, *words, capsys=capsys)[0] == 0
    assert (where / "back.ect").read_bytes() == (where / "one.ect").read_bytes()


def test_an_error_model_in_place_of_a_table_is_called_one(where: Path, capsys: Any) -> None:
    (where / "error_model.json").write_text('{"error_model": 1, "components": []}', encoding="utf-8")
    words = ("promote", where / "reg", "7", where / "error_model.json", "--why", "new")
    code, document = run(where, *words, capsys=capsys)
    assert code == 6 and "is an error model (a compensation table is needed" in document["error"]["message"]


def test_what_a_file_was_on_at_a_time_is_not_what_it_was_on_before(where: Path, capsys: Any) -> None:
    """The table of January was replaced in February: in March it is on no machine."""
    for day, table in (("2026-01-10", "one.ect"), ("2026-02-01", "two.ect")):
        words = ("promote", where / "reg", "7", where / table, "--why", "measured", "--time", day)
        assert run(where, *words, capsys=capsys)[0] == 0
    for day, numbers in (("2026-01-20", [1]), ("2026-03-01", [])):
        words = ("log", where / "reg", "--file", where / "one.ect", "--at", day)
        _, document = run(where, *words, capsys=capsys)
        assert [e["number"] for e in document["result"]["entries"]] == numbers


def test_a_day_has_all_tables_that_were_on_the_machine_in_it(where: Path, capsys: Any) -> None:
    """A part was cut at noon with the table of that morning: `--at 2026-03-03` showed the one before alone."""
    for time, table in (("2026-02-01", "one.ect"), ("2026-03-03T08:00:00Z", "two.ect"), ("2026-03-09", "one.ect")):
        words = ("promote", where / "reg", "7", where / table, "--why", "measured", "--time", time)
        assert run(where, *words, capsys=capsys)[0] == 0
    days = {"2026-03-03": [1, 2], "2026-03-02": [1], "2026-03-03T12:00:00Z": [2], "2026-03-04": [2], "2026-01-01": []}
    for day, numbers in days.items():
        _, document = run(where, "log", where / "reg", "7", "--at", day, capsys=capsys)
        assert [e["number"] for e in document["result"]["entries"]] == numbers, day


def test_a_registry_or_machine_that_is_not_there_is_no_empty_history(where: Path, capsys: Any) -> None:
    code, document = run(where, "log", where / "rge", "7", capsys=capsys)
    assert code == 2 and "no registry here" in document["error"]["message"]
    assert run(where, "promote", where / "reg", "mill-3", where / "one.ect", "--why", "new", capsys=capsys)[0] == 0
    code, document = run(where, "log", where / "reg", "mil-3", capsys=capsys)
    assert code == 2 and "Did you mean mill-3?" in document["error"]["message"]


def test_a_clock_that_went_back_is_reported_not_recorded(where: Path, capsys: Any) -> None:
    first = ("promote", where / "reg", "7", where / "one.ect", "--why", "new", "--time", "2190-01-01")
    assert run(where, *first, capsys=capsys)[0] == 0
    again = ("promote", where / "reg", "7", where / "two.ect", "--why", "measured")
    code, document = run(where, *again, capsys=capsys)
    assert code == 2 and "before entry 1" in document["error"]["message"]
    assert run(where, *again, "--time", "2026-03-01", capsys=capsys)[0] == 0
    _, document = run(where, "log", where / "reg", "7", "--at", "2026-03-02", capsys=capsys)
    assert [e["number"] for e in document["result"]["entries"]] == [2]


@pytest.mark.parametrize("verb", ["promote", "rollback"])
def test_a_future_time_is_reported(where: Path, capsys: Any, verb: str) -> None:
    """2062 for 2026 stays on record for good: `log --at` would not show the table until then."""
    for table, day in (("one.ect", "2026-01-01"), ("two.ect", "2026-01-02")):
        words = ("promote", where / "reg", "7", where / table, "--why", "measured", "--time", day)
        assert "remark" not in run(where, *words, capsys=capsys)[1]["result"]
    table = [where / "one.ect"] if verb == "promote" else []
    late = (verb, where / "reg", "7", *table, "--why", "worse", "--time", "2162-11-25")
    code, document = run(where, *late, capsys=capsys)
    assert code == 0 and "2162-11-25T00:00:00Z is later than this host's clock" in document["result"]["remark"]


def test_a_changed_table_is_refused_as_such_where_there_is_nothing_to_go_back_to(where: Path, capsys: Any) -> None:
    for _ in range(2):
        words = ("promote", where / "reg", "7", where / "one.ect", "--why", "measured")
        assert run(where, *words, capsys=capsys)[0] == 0
    assert run(where, "rollback", where / "reg", "7", "--why", "worse", capsys=capsys)[0] == 2
    data = (where / "one.ect").read_bytes()
    (object_,) = (p for p in (where / "reg/objects").rglob("*") if p.is_file() and p.read_bytes() == data)
    object_.unlink()
    object_.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert run(where, "rollback", where / "reg", "7", "--why", "worse", capsys=capsys)[0] == 6


def test_whatever_is_touched_is_refused(where: Path, key: minisign.SecretKey) -> None:
    """Every byte of every file counts: one bit turned anywhere, one file gone or put in another's place."""
    filled(where, key)
    sound = where / "sound"
    (where / "reg").rename(sound)

    def refused(change: Any) -> bool:
        shutil.rmtree(where / "reg", ignore_errors=True)
        shutil.copytree(sound, where / "reg")
        change()
        store = Registry(where / "reg", key.public)
        try:
            history = store.history("7")
            for entry in history:
                store.table(entry)
        except VerifyError:
            return True
        return len(history) != 3

    rng = random.Random(3)
    for file in sorted(p.relative_to(sound) for p in sound.rglob("*") if p.is_file()):
        target = where / "reg" / file
        data = (sound / file).read_bytes()
        first = data.index(b"\n") + 1 if file.suffix == ".minisig" else 0  # the first line of a signature is not signed
        for at in {rng.randrange(first, len(data)) for _ in range(6)}:
            turned = data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]

            def write(target: Path = target, turned: bytes = turned) -> None:
                target.unlink()
                target.write_bytes(turned)

            assert refused(write), (file, at)
        assert refused(lambda target=target: target.unlink()), file
    entries = where / "reg" / "machines" / "7"
    assert refused(lambda: (entries / "000002").rename(entries / "000004"))
    assert refused(lambda: shutil.copy(entries / "000001", entries / "000004"))
    assert not refused(lambda: None)


def test_a_name_that_leaves_the_registry_is_refused(where: Path, key: minisign.SecretKey) -> None:
    for machine in ("../x", "", "a/b", ".", "..", "a\nb"):
        with pytest.raises(UsageError):
            Registry(where / "reg", key.public).history(machine)


def test_of_two_simultaneous_promotions_one_wins_and_one_is_refused(where: Path, key: minisign.SecretKey) -> None:
    filled(where, key, 1)

    def promote(n: int) -> str:
        try:
            Registry(where / "reg", key.public).append("7", "promote", b"t%d" % n, "x", "2026-01-02", key, 1)
            return "won"
        except GateError as err:
            assert "another writer was first" in str(err)
            return "refused"

    with ThreadPoolExecutor(8) as pool:
        assert sorted(pool.map(promote, range(8))) == ["refused"] * 7 + ["won"]
    assert len(Registry(where / "reg", key.public).history("7")) == 2


def test_a_few_kills_and_full_disks_lose_nothing(tmp_path: Path) -> None:
    entries, wrong = campaign(tmp_path, 16, seed=5)
    assert wrong == [] and entries >= 1


@pytest.mark.slow
def test_many_kills_lose_nothing(tmp_path: Path) -> None:
    entries, wrong = campaign(tmp_path, 150, seed=6)
    assert wrong == [] and entries > 20


def test_an_entry_that_is_lost_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The campaign finds what is planted: a history that forgets its last entry now and then."""
    whole, calls = Registry.history, []

    def forgetful(self: Registry, machine: str) -> list[Any]:
        calls.append(1)
        complete = whole(self, machine)
        return complete[:-1] if len(calls) % 3 == 0 else complete

    monkeypatch.setattr(Registry, "history", forgetful)
    assert campaign(tmp_path, 60, seed=5)[1] != []


def test_a_full_disk_is_a_message_and_loses_nothing(where: Path, key: minisign.SecretKey) -> None:
    store = filled(where, key, 2)
    pid = os.fork()
    if pid == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
        try:
            store.append("7", "promote", bytes(5000), "too large", "2026-01-02", key, 2)
        except OSError as err:
            os._exit(7 if err.filename is not None else 8)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 7
    assert len(store.history("7")) == 2 and not list((where / "reg").rglob(".new-*"))


# ---------------------------------------------------------------- keys and signatures


def test_a_signature_holds_for_its_bytes_and_its_key_only(where: Path, key: minisign.SecretKey) -> None:
    table = where / "one.ect"
    minisign.sign_file(table, key, "machine 7")
    assert minisign.verify_file(table, key.public) == "machine 7"
    with pytest.raises(VerifyError, match="signed by the key"):
        minisign.verify_file(table, minisign.generate().public)
    with pytest.raises(VerifyError, match="is not signed"):
        minisign.verify_file(where / "two.ect", key.public)
    beside = where / "one.ect.minisig"
    beside.write_text(beside.read_text().replace("machine 7", "machine 8"))
    with pytest.raises(VerifyError, match="was changed"):
        minisign.verify_file(table, key.public)


def test_keys_are_private_and_never_overwritten(where: Path, key: minisign.SecretKey) -> None:
    secret = where / "keys/errpipe.key"
    assert secret.stat().st_mode & 0o777 == 0o600
    assert minisign.read_secret(secret) == key
    with pytest.raises(UsageError, match="never overwritten"):
        minisign.write_pair(key, where / "keys")
    secret.chmod(0o644)
    with pytest.raises(VerifyError, match="others can read"):
        minisign.read_secret(secret)
    for text in ("", "a\nb\n", "untrusted comment: x\n" + "A" * 300 + "\n"):
        (where / "x.pub").write_text(text)
        with pytest.raises((VerifyError, DataError)):
            minisign.read_public(where / "x.pub")


def test_the_verbs_sign_and_verify(where: Path, capsys: Any) -> None:
    assert (
        main(["sign", str(where / "one.ect"), "--key", str(where / "keys/errpipe.key"), "--comment", "machine 7"]) == 0
    )
    public = ["--public-key", str(where / "keys/errpipe.pub")]
    assert main(["verify-signature", str(where / "one.ect"), *public]) == 0
    assert "machine 7" in capsys.readouterr().out
    (where / "one.ect").write_bytes((where / "two.ect").read_bytes())
    assert main(["verify-signature", str(where / "one.ect"), *public]) == 6


@pytest.mark.toolchain
@pytest.mark.skipif(shutil.which("minisign") is None, reason="the program minisign is not installed")
def test_minisign_and_errpipe_read_each_other(where: Path, key: minisign.SecretKey) -> None:
    """The real program verifies and signs with our keys, and ours with its keys."""

    def program(*words: str | Path) -> str:
        done = subprocess.run(["minisign", *map(str, words)], capture_output=True, text=True, timeout=60)
        return done.stdout if done.returncode == 0 else f"failed: {done.stderr}"

    table, keys = where / "one.ect", where / "keys"
    minisign.sign_file(table, key, "machine 7")
    assert "machine 7" in program("-V", "-p", keys / "errpipe.pub", "-m", table)
    program("-S", "-s", keys / "errpipe.key", "-m", table, "-t", "by the program")
    assert minisign.verify_file(table, key.public) == "by the program"
    program("-G", "-W", "-p", where / "m.pub", "-s", where / "m.key")
    (where / "m.key").chmod(0o600)
    theirs = minisign.read_secret(where / "m.key")
    assert theirs.public == minisign.read_public(where / "m.pub")
    minisign.sign_file(where / "two.ect", theirs, "by errpipe")
    assert "by errpipe" in program("-V", "-p", where / "m.pub", "-m", where / "two.ect")
    table.write_bytes(table.read_bytes() + b"x")
    assert program("-V", "-p", keys / "errpipe.pub", "-m", table).startswith("failed")


def test_a_table_on_a_stick_under_another_name_is_known_by_its_content(where: Path, capsys: Any) -> None:
    """`verify`, `whatis`, `log` and `compare` took the end of its name for what it is, or asked for a folder."""
    found = where / "USB_0001.dat"
    shutil.copy(where / "one.ect", found)
    run(where, "promote", where / "reg", "7", where / "one.ect", "--why", "new", capsys=capsys)
    assert main(["whatis", str(found)]) == 0 and "compensation table" in capsys.readouterr().out
    assert main(["verify", str(found)]) == 0 and "checksum, layout and limits hold" in capsys.readouterr().out
    assert main(["compare", str(where / "one.ect"), str(found), "--max-um", "0"]) == 0
    assert run(where, "log", where / "reg", "--file", found, capsys=capsys)[0] == 0
    assert run(where, "verify", found, capsys=capsys)[0] == 6  # unsigned
    main(["sign", str(found), "--key", str(where / "keys/errpipe.key")])
    assert run(where, "verify", found, capsys=capsys)[0] == 0
    found.write_bytes(found.read_bytes()[:-9] + b"\x01" + found.read_bytes()[-8:])
    assert main(["verify", str(found)]) == 6
    assert main(["verify", str(where / "reg")]) == 6 and "errpipe log" in capsys.readouterr().err
