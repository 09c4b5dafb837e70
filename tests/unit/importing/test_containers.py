"""The known test from workbooks, binary containers and logs of controllers, made by independent libraries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError, UsageError
from errpipe.importing.readers import markup
from errpipe.importing.sheet import ReaderOptions
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows


def test_excel_by_openpyxl(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="the sample is made by openpyxl")
    pytest.importorskip("python_calamine", reason="the extra `excel` is not installed")
    book = openpyxl.Workbook()
    book.active.append(["a cover sheet"])
    sheet = book.create_sheet("X-Achse")
    sheet.append(["Machine: VMC 3"])
    sheet.append([])
    sheet.append(["Target [mm]", *(f"Run {r} {w} [µm]" for r in (1, 2, 3) for w in ("up", "down"))])
    for i, x in enumerate(TARGETS):
        sheet.append([float(x), *(float(deviation(r, s)[i]) for r in (1, 2, 3) for s in (1.0, -1.0))])
    book.save(tmp_path / "test.xlsx")
    holds_the_truth(imported(tmp_path, tmp_path / "test.xlsx"))
    with pytest.raises(UsageError, match="no sheet 'Y'"):
        imported(tmp_path, tmp_path / "test.xlsx", ReaderOptions(sheet="Y"))


def test_excel_by_xlsxwriter_long_with_merged_header(tmp_path: Path) -> None:
    xlsxwriter = pytest.importorskip("xlsxwriter", reason="the sample is made by xlsxwriter")
    pytest.importorskip("python_calamine", reason="the extra `excel` is not installed")
    with xlsxwriter.Workbook(tmp_path / "long.xlsx") as book:
        sheet = book.add_worksheet()
        sheet.merge_range("A1:D1", "Positioning test of axis X")
        sheet.write_row(2, 0, ["Run", "Position [mm]", "Direction", "Deviation [mm]"])
        for i, (r, x, s, d) in enumerate(long_rows()):
            sheet.write_row(3 + i, 0, [int(r), x, "+" if s > 0 else "-", d / 1000])
    holds_the_truth(imported(tmp_path, tmp_path / "long.xlsx"))


def test_tdms_by_nptdms(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms", reason="the extra `tdms` is not installed")
    rows = long_rows()
    names = {"run": [float(r) for r, *_ in rows], "x_cmd": [x for _, x, *_ in rows]}
    names["x_act"] = [x + d / 1000 for _, x, _, d in rows]
    with nptdms.TdmsWriter(str(tmp_path / "t.tdms")) as writer:
        properties = {"wf_increment": 2.0, "unit_string": "mm"}
        writer.write_segment(
            [
                nptdms.ChannelObject("axis", n, np.array(v), properties={} if n == "run" else properties)
                for n, v in names.items()
            ]
        )
    holds_the_truth(imported(tmp_path, tmp_path / "t.tdms"))


def test_hdf5_and_matlab_73_by_h5py(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="the extra `hdf` is not installed")
    rows = long_rows()
    with h5py.File(tmp_path / "t.h5", "w") as file:
        group = file.create_group("X")
        group["run"] = [int(r) for r, *_ in rows]
        group["target"] = [x for _, x, *_ in rows]
        group["target"].attrs["units"] = "mm"
        group["deviation"] = [d for *_, d in rows]
        group["deviation"].attrs["units"] = "um"
        file["scalar"] = 3.0
    holds_the_truth(imported(tmp_path, tmp_path / "t.h5"))


def test_matlab_by_scipy(tmp_path: Path) -> None:
    from scipy.io import savemat

    rows = long_rows()
    test = {"run": [int(r) for r, *_ in rows], "x_target": [x for _, x, *_ in rows], "error_um": [d for *_, d in rows]}
    savemat(tmp_path / "t.mat", {"test": test, "note": "axis X"})
    holds_the_truth(imported(tmp_path, tmp_path / "t.mat"))


def test_mtconnect(tmp_path: Path) -> None:
    samples = "".join(
        f'<Position dataItemId="xc" name="X_cmd" timestamp="2026-03-12T08:00:{i:02d}.000Z">{x}</Position>'
        f'<Position dataItemId="xa" name="X_act" timestamp="2026-03-12T08:00:{i:02d}.000Z">{x + 0.01}</Position>'
        for i, x in enumerate(np.linspace(0, 90, 10))
    )
    text = f'<?xml version="1.0"?><MTConnectStreams xmlns="urn:mtconnect.org:MTConnectStreams:1.5"><Streams>{samples}'
    (tmp_path / "s.xml").write_text(text + "</Streams></MTConnectStreams>")
    recording = imported(tmp_path, tmp_path / "s.xml")
    assert recording.array("EXX") == pytest.approx(10.0, abs=1e-6)
    (tmp_path / "bomb.xml").write_text('<!DOCTYPE x [<!ENTITY a "b">]>' + text + "</Streams></MTConnectStreams>")
    with pytest.raises(DataError, match="entities"):
        imported(tmp_path, tmp_path / "bomb.xml")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_records_of_xml_in_any_encoding_and_no_entities(tmp_path: Path, encoding: str) -> None:
    records = "".join(f'<r t="{k}" x="{10 * k}" e="7"/>' for k in range(9))
    begin = f'<?xml version="1.0" encoding="{encoding}"?>'
    (tmp_path / "log.xml").write_text(f"{begin}<a>{records}</a>", encoding=encoding)
    (sheet,) = markup.read(tmp_path / "log.xml", ReaderOptions())
    assert sheet.header == ["t", "x", "e"] and len(sheet.rows) == 9
    (tmp_path / "bomb.xml").write_text(f'{begin}<!DOCTYPE a [<!ENTITY b "7">]><a>{records}</a>', encoding=encoding)
    with pytest.raises(DataError, match="its own entities"):
        markup.read(tmp_path / "bomb.xml", ReaderOptions())


def test_halsampler_with_and_without_counter(tmp_path: Path) -> None:
    x = np.linspace(0, 100, 800)
    for counter in (True, False):
        lines = [f"{f'{i} ' if counter else ''}{v:.6f} {v - 0.005:.6f}" for i, v in enumerate(x)]
        (tmp_path / "hal.log").write_text("\n".join(["overrun", *lines, ""]))
        recording = imported(tmp_path, tmp_path / "hal.log", ReaderOptions(names=("x_cmd", "x_fb"), period=0.002))
        assert recording.array("EXX") == pytest.approx(-5.0, abs=1e-6)
        assert np.diff(recording.time()) == pytest.approx(0.002)
        assert recording.names("simulated") and recording.names("velocity", axis="X")


def test_counts_and_current_are_derived_and_stated(tmp_path: Path) -> None:
    lines = ["t [s];x_cmd [mm];encoder counts;motor current [mA]"]
    lines += [f"{i * 0.001};{x:.6f};{round((x + 0.01) * 1000)};{250}" for i, x in enumerate(np.arange(0, 60, 0.1))]
    (tmp_path / "c.csv").write_text("\n".join(lines))
    recording = imported(tmp_path, tmp_path / "c.csv", resolution=0.001, torque_constant=0.4)
    assert recording.array("EXX") == pytest.approx(10.0, abs=1e-6)
    (torque,) = recording.names("torque")
    assert recording.array(torque) == pytest.approx(0.1)
    text = (tmp_path / "rec" / "recording.yaml").read_text()
    assert "factor: 0.001" in text and "derived: " in text


def test_klipper_frame_expansion(tmp_path: Path) -> None:
    lines = ["sample,time,frame_t,bed_t,chamber_t,Z error [mm]"]
    lines += [f"{i},{60 * i},{22 + i / 10:.2f},{90},{30 + i / 20:.2f},{-0.01 * i:.4f}" for i in range(60)]
    (tmp_path / "frame.csv").write_text("\n".join(lines))
    recording = imported(tmp_path, tmp_path / "frame.csv", component="E_Z", sets=["sample.role=ignore"])
    assert len(recording.names("temperature")) == 3
    assert recording.components() == ("E_Z",)


def test_several_files_are_runs(tmp_path: Path) -> None:
    for run in (1, 2, 3):
        lines = ["Target [mm];Dir;Deviation [um]"] + [
            f"{x};{s:+.0f};{d}" for r, x, s, d in long_rows() if r == str(run)
        ]
        (tmp_path / f"run{run}.csv").write_text("\n".join(lines))
    recording = imported(tmp_path, [tmp_path / f"run{r}.csv" for r in (1, 2, 3)])
    assert recording.run_labels() == ("run1", "run2", "run3")
    holds_the_truth(recording)
