"""Rollbacks: to which table they return, what they put on record, and registries of older versions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from errpipe.errors import VerifyError
from errpipe.registry import minisign
from errpipe.registry.store import Entry
from errpipe.tables import ect
from tests.unit.registry.command_line import filled, run
from tests.unit.targets import machines


def test_a_second_rollback_does_not_bring_the_bad_table_back(where: Path, capsys: Any) -> None:
    """One, two, three were promoted; three is bad, and so turns out two: twice back is one, then none."""
    reg = where / "reg"
    ect.write(machines.bent(), where / "three.ect")
    for name in ("one.ect", "two.ect", "three.ect"):
        words = ("promote", reg, "7", where / name, "--why", name, "--other-outputs")
        assert run(where, *words, capsys=capsys)[0] == 0
    back = ("rollback", reg, "7", "--why", "bad", "--out", where / "back.ect")
    for name in ("two.ect", "one.ect"):
        assert run(where, *back, capsys=capsys)[0] == 0
        assert (where / "back.ect").read_bytes() == (where / name).read_bytes()
    code, document = run(where, *back, capsys=capsys)
    assert code == 2 and "no earlier table to go back to (--to: entries 1 to 5)" in document["error"]["message"]
    assert run(where, *back, "--to", "3", capsys=capsys)[0] == 0
    assert run(where, *back, capsys=capsys)[0] == 0
    assert (where / "back.ect").read_bytes() == (where / "two.ect").read_bytes()


def test_a_table_promoted_twice_is_not_come_back_from_to_what_was_taken_off(where: Path, capsys: Any) -> None:
    """One, two, one again: back is two, then the first one, then none. The third rollback brought two back."""
    reg = where / "reg"
    for name in ("one.ect", "two.ect", "one.ect"):
        assert run(where, "promote", reg, "7", where / name, "--why", name, capsys=capsys)[0] == 0
    back = ("rollback", reg, "7", "--why", "bad", "--out", where / "back.ect")
    for name in ("two.ect", "one.ect"):
        assert run(where, *back, capsys=capsys)[0] == 0
        assert (where / "back.ect").read_bytes() == (where / name).read_bytes()
    assert run(where, *back, capsys=capsys)[0] == 2


def promoted(where: Path, capsys: Any, *names: str) -> None:
    ect.write(machines.bent(), where / "three.ect")
    for name in names:
        words = ("promote", where / "reg", "7", where / name, "--why", name, "--other-outputs")
        assert run(where, *words, capsys=capsys)[0] == 0


def gone_back(where: Path, capsys: Any, *words: str) -> bytes | int:
    """The table that a rollback wrote, or its exit code."""
    back = ("rollback", where / "reg", "7", "--why", "bad", "--out", where / "back.ect", *words)
    code, _ = run(where, *back, capsys=capsys)
    return (where / "back.ect").read_bytes() if code == 0 else code


@pytest.mark.parametrize(("to", "then"), [("1", []), ("3", ["two.ect", "one.ect"])])
def test_a_rollback_to_one_of_two_promotions_of_a_table_goes_on_from_that_one(
    where: Path, capsys: Any, to: str, then: list[str]
) -> None:
    """One, two, one, three; `--to 1` and then back again went from the third entry to two."""
    promoted(where, capsys, "one.ect", "two.ect", "one.ect", "three.ect")
    assert gone_back(where, capsys, "--to", to) == (where / "one.ect").read_bytes()
    for name in then:
        assert gone_back(where, capsys) == (where / name).read_bytes()
    assert gone_back(where, capsys) == 2
    _, document = run(where, "log", where / "reg", "7", capsys=capsys)
    back_to = [e["back_to"] for e in document["result"]["entries"]]
    assert back_to == [0, 0, 0, 0, int(to), *[2, 1][: len(then)]]


def test_a_history_of_entries_that_state_no_number_is_read_and_goes_on(
    where: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Version 1 of an entry, as registries hold it: verified, and rolled back by its table."""

    def version_1(entry: Entry) -> dict[str, Any]:
        names = ("machine", "number", "action", "table", "time", "why", "previous")
        return {"registry_entry": 1} | {name: getattr(entry, name) for name in names}

    with monkeypatch.context() as patched:
        patched.setattr(Entry, "plain", version_1)
        promoted(where, capsys, "one.ect", "two.ect", "one.ect", "three.ect")
        assert gone_back(where, capsys, "--to", "1") == (where / "one.ect").read_bytes()
    assert gone_back(where, capsys) == (where / "two.ect").read_bytes()  # from the nearest promotion of one
    assert gone_back(where, capsys, "--to", "5") == (where / "one.ect").read_bytes()
    assert gone_back(where, capsys) == (where / "two.ect").read_bytes()
    code, document = run(where, "log", where / "reg", "7", capsys=capsys)
    assert code == 0 and [e["back_to"] for e in document["result"]["entries"]] == [0, 0, 0, 0, 0, 2, 5, 2]


def test_an_entry_that_returns_to_another_table_than_it_holds_is_refused(where: Path, key: minisign.SecretKey) -> None:
    store = filled(where, key, 2)
    store.append("7", "rollback", b"table 0", "worse", "2026-01-02T00:00:00Z", key, 2, back_to=2)
    with pytest.raises(VerifyError, match="is not entry 3"):
        store.history("7")


@pytest.mark.parametrize("name", ["closed/back.ect", "folder"])
def test_a_rollback_whose_file_cannot_be_written_is_not_on_record(where: Path, capsys: Any, name: str) -> None:
    """Tried again, it would go back a second table."""
    promoted(where, capsys, "one.ect", "two.ect")
    (where / "folder").mkdir()
    (where / "closed").write_text("", encoding="utf-8")
    words = ("rollback", where / "reg", "7", "--why", "bad", "--out", where / name)
    code, document = run(where, *words, capsys=capsys)
    assert code == 2 and str(where / name.partition("/")[0]) in document["error"]["message"]
    assert len(run(where, "log", where / "reg", "7", capsys=capsys)[1]["result"]["entries"]) == 2
