"""Hostile measurement files given to `errpipe import`: few bytes that unpack to much, values kept elsewhere."""

from __future__ import annotations

import gzip
import struct
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from errpipe.importing.readers import open_file
from errpipe.importing.sheet import ReaderOptions
from tests.hostile.command_line import command

SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{}</sheetData></worksheet>'
)
PARTS = {
    "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"/>',
    "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Id="rId1" Target="xl/workbook.xml" '
    'Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/officeDocument"/></Relationships>',
    "xl/workbook.xml": '<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" '
    'xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships">'
    '<sheets><sheet name="a" sheetId="1" r:id="rId1"/></sheets></workbook>',
    "xl/_rels/workbook.xml.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet" '
    'Target="worksheets/sheet1.xml"/></Relationships>',
}


def refused(path: Path, tmp_path: Path, capsys) -> str:
    """The message; nothing is written, and it does not take long."""
    began = time.monotonic()
    code, said = command("import", path, "--out", tmp_path / "rec", "--yes", capsys=capsys)
    assert code == 3 and not (tmp_path / "rec").exists(), (code, said)
    assert time.monotonic() - began < 60
    return said


def workbook(path: Path, rows: str) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in (PARTS | {"xl/worksheets/sheet1.xml": SHEET.format(rows)}).items():
            archive.writestr(name, text)
    return path


def test_a_workbook_of_two_distant_cells(tmp_path, capsys):
    """Readers make a rectangle of it: 1,048,576 rows of 16,384 columns, 400 GB."""
    sound = '<row r="1"><c r="A1"><v>1</v></c></row><row r="3"><c r="B3"><v>2</v></c></row>'
    assert open_file(workbook(tmp_path / "sound.xlsx", sound), ReaderOptions())[1][0].rows[2] == [None, 2.0]
    rows = '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"><v>2</v></c></row>'
    path = workbook(tmp_path / "far.xlsx", rows)
    assert path.stat().st_size < 2000
    assert "takes more than 3 GB" in refused(path, tmp_path, capsys)


def test_a_workbook_of_two_cells_a_little_nearer(tmp_path, capsys):
    """20 million cells fit in memory, but not as Python's."""
    rows = '<row r="1"><c r="A1"><v>1</v></c></row><row r="200000"><c r="CV200000"><v>2</v></c></row>'
    assert "cells (at most" in refused(workbook(tmp_path / "near.xlsx", rows), tmp_path, capsys)


def test_an_hdf5_data_set_without_end_that_is_all_fill_value(tmp_path, capsys):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "huge.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(1 << 40,), chunks=(1 << 16,), dtype="f8")
    assert path.stat().st_size < 1 << 16
    assert f"{1 << 40} cells" in refused(path, tmp_path, capsys)


def test_an_hdf5_data_set_that_is_another_file(tmp_path, capsys):
    """HDF5 can name any file as the place of a data set's bytes: a password file would become a recording."""
    h5py = pytest.importorskip("h5py")
    secret = tmp_path / "secret.bin"
    secret.write_bytes(np.arange(20.0).tobytes())
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file.create_dataset("x", shape=(20,), dtype="f8", external=[(str(secret), 0, 160)])
    with h5py.File(tmp_path / "own.h5", "w") as file:
        file["x"] = np.arange(20.0)
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout(shape=(20,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "own.h5"), "x", shape=(20,))
        file.create_virtual_dataset("x", layout)
    with h5py.File(tmp_path / "linked.h5", "w") as file:
        file["x"] = h5py.ExternalLink(str(tmp_path / "own.h5"), "x")
    for name in ("external.h5", "virtual.h5"):
        assert "another file" in refused(tmp_path / name, tmp_path, capsys)
    assert "no rows" in refused(tmp_path / "linked.h5", tmp_path, capsys)


def test_a_tdms_channel_that_states_more_values_than_there_are(tmp_path, capsys):
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "t.tdms"
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("g", "x", np.arange(100.0))])
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<Q", 100))
    data[at : at + 8] = struct.pack("<Q", 1 << 40)
    path.write_bytes(data)
    refused(path, tmp_path, capsys)


def test_a_matlab_variable_that_unpacks_to_a_thousand_times_its_size(tmp_path, capsys):
    from scipy.io import savemat

    path = tmp_path / "bomb.mat"
    savemat(path, {"x": np.zeros(13_000_000)}, do_compression=True)
    assert path.stat().st_size < 1 << 20
    assert "13000000 cells" in refused(path, tmp_path, capsys)


@pytest.mark.parametrize("text", [pytest.param("\n", marks=pytest.mark.slow), "1,", "1 ", "1\r"], ids=repr)
def test_a_text_of_very_many_cells(tmp_path, capsys, text):
    path = tmp_path / "many.csv"
    line = text * 400 if text[0] != "\n" else text
    path.write_text("a,b\n" + (line + "\n") * (30_000_000 // len(line)))
    assert "cells" in refused(path, tmp_path, capsys)


def test_a_stream_of_a_new_item_at_every_time(tmp_path, capsys):
    """One column per item and one row per time: n values would be n x n cells."""
    items = "".join(
        f'<Position dataItemId="d{n}" timestamp="2026-01-01T00:00:{n % 60:02d}.{n:06d}Z">1</Position>'
        for n in range(20_000)
    )
    path = tmp_path / "s.xml"
    path.write_text(f"<MTConnectStreams>{items}</MTConnectStreams>")
    assert f"{20_000**2} cells" in refused(path, tmp_path, capsys)


@pytest.mark.parametrize("size", [1e-320, 1e-200, 1e200, 1e306])
def test_values_too_small_or_large_for_a_slope_say_nothing(size):
    from errpipe.importing import readings

    x = size * np.arange(6.0)
    assert readings.slope_of(x, np.arange(6.0)) is None
    assert readings.slope_of(np.arange(6.0), 2.0 * np.arange(6.0) + 1) == pytest.approx(2.0)


def test_a_tdms_file_that_is_cut_is_read_as_far_as_it_goes_and_says_so(tmp_path, capsys):
    nptdms = pytest.importorskip("nptdms")
    from errpipe.importing.readers import tdms
    from errpipe.importing.sheet import ReaderOptions

    path = tmp_path / "t.tdms"
    with nptdms.TdmsWriter(str(path)) as writer:
        for _ in range(2):
            writer.write_segment([nptdms.ChannelObject("g", n, np.arange(100.0)) for n in ("x", "EXX")])
    path.write_bytes(path.read_bytes()[:-100])
    (sheet,) = tdms.read(path, ReaderOptions())
    assert 180 < sum(row[1] is not None for row in sheet.rows) < 200
    assert any("segment" in note for note in sheet.notes)
    assert capsys.readouterr().err == ""


def test_a_packed_file_that_unpacks_to_more_than_is_imported(tmp_path, capsys):
    path = tmp_path / "x.csv.gz"
    path.write_bytes(gzip.compress(bytes(300 << 20)))
    assert path.stat().st_size < 1 << 20
    said = refused(path, tmp_path, capsys)
    assert "x.csv.gz: more than 256 MB unpacked" in said.replace("\n", " ")
