"""`signed: required`: no table leaves unsigned or touched, and its signature goes along into every format with room."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pytest

import errpipe
from errpipe.cli.app import main
from errpipe.errors import VerifyError
from errpipe.registry import minisign, signed
from errpipe.tables import ect
from errpipe.targets import TARGETS
from tests.e2e.retrain.test_retrain import PIPELINE, record
from tests.unit.targets import machines

EXPORT = """  - kind: export
    signed: required
    public_key: keys/errpipe.pub
    targets: [linuxcnc_screw, ecmc_lut]
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A pipeline that exports signed tables only, and a key pair; no secret key is named."""
    monkeypatch.delenv("ERRPIPE_KEY", raising=False)
    minisign.write_pair(minisign.generate(), tmp_path / "keys")
    (tmp_path / "axis.yaml").write_text(PIPELINE + EXPORT, encoding="utf-8")
    record(tmp_path / "recording", 12)
    return tmp_path


def run(site: Path, *more: str, out: str = "out") -> int:
    return main(["run", str(site / "axis.yaml"), "--out", str(site / out), *more])


def test_an_unsigned_table_is_not_exported_and_a_signed_one_carries_its_signature(
    site: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    assert run(site) == 6
    assert "is not signed" in capsys.readouterr().err and not (site / "out/export").exists()
    monkeypatch.setenv("ERRPIPE_KEY", str(site / "keys/errpipe.key"))
    assert run(site) == 0
    exported = site / "out/export"
    public = ["--public-key", str(site / "keys/errpipe.pub")]
    assert main(["verify", str(exported), *public]) == 0
    name = errpipe.Table.read(exported / "table.ect").identity
    text = (exported / "ecmc_lut/X_lut.dat").read_text(encoding="utf-8")
    assert f"made from table {name}" in text
    assert not (exported / "linuxcnc_screw/x.comp").read_text(encoding="utf-8").count("remark")  # no room for comments
    (exported / "table.ect").write_bytes((exported / "table.ect").read_bytes()[:-1] + b"\1")
    assert main(["verify", str(exported), *public]) == 6


def test_what_a_person_signed_is_exported_and_nothing_else(site: Path) -> None:
    """Somebody looks at the table, signs it, and the pipeline exports that very table; a new one is refused."""
    assert run(site, "--set", "export.signed=optional", out="review") == 0
    assert main(["sign", str(site / "review/export/table.ect"), "--key", str(site / "keys/errpipe.key")]) == 0
    (site / "review/export/table.ect.minisig").rename(site / "table.minisig")
    with_signature = ("--set", "export.signature=table.minisig")
    assert run(site, *with_signature) == 0
    record(site / "recording", 13)
    assert run(site, *with_signature) == 6
    other = minisign.write_pair(minisign.generate(), site / "other")[1]
    assert run(site, *with_signature, "--set", f"export.public_key={other}") == 6


def test_a_key_must_be_named(site: Path, capsys: Any) -> None:
    text = (PIPELINE + EXPORT).replace("    public_key: keys/errpipe.pub\n", "")
    (site / "axis.yaml").write_text(text, encoding="utf-8")
    assert run(site) == 2
    assert "`signed: required` needs it" in capsys.readouterr().err


def test_export_of_a_file_and_reading_it_in_python(site: Path) -> None:
    table = site / "one.ect"
    ect.write(machines.too_long_at_plus_x(), table)
    public = str(site / "keys/errpipe.pub")
    words = ["export", str(table), "--target", "weihong_axeserr", "--out", str(site / "x"), "--public-key", public]
    assert main(words) == 6
    with pytest.raises(VerifyError, match="is not signed"):
        errpipe.Table.read(table, public)
    minisign.sign_file(table, minisign.read_secret(site / "keys/errpipe.key"), 'reviewed */ *) " ; %')
    assert main(words) == 0
    assert main(["verify", str(site / "x"), "--public-key", public]) == 0
    read = errpipe.Table.read(table, public)
    assert read.identity == read.cycle(unlimited=True).identity == ect.fingerprint(machines.too_long_at_plus_x())
    table.write_bytes(table.read_bytes()[:-8] + bytes(8))
    with pytest.raises(VerifyError, match="was changed"):
        errpipe.Table.read(table, public)


@pytest.mark.parametrize("target", [t for t in TARGETS if t.remark], ids=lambda t: t.name)
def test_a_remark_changes_nothing_that_the_controller_reads(target: Any) -> None:
    """The signature stands in the file whole, on lines of at most 200 signs, and the file reads as it did."""
    key, table = minisign.generate(), machines.sample(target)
    text = key.sign(ect.dumps(table), "machine 7")
    files = target.write(table)
    remarked = target.with_remarks(files, signed.remarks(table, text, key.public))
    added = "".join(line for n in files for line in remarked[n].splitlines(keepends=True) if "errpipe remark" in line)
    assert target.without_remarks(remarked) == files
    for line in text.splitlines()[1::2]:
        assert line.rstrip("=") in added and base64.b64decode(line)
    assert max(map(len, added.splitlines())) <= 200
    assert repr(target.read_back(remarked)) == repr(target.read_back(files))
    for name in files:  # what only looks like a remark is not passed over
        planted = remarked | {name: remarked[name] + "system(); /* errpipe remark: x */\n"}
        assert target.without_remarks(planted) != files
