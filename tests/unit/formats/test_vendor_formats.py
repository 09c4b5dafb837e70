"""Formats of measuring programs: values, directions, and what is refused."""

import os
from pathlib import Path

import numpy as np
import pytest

from errpipe import formats
from errpipe.errors import DataError, UsageError
from errpipe.formats import ecmc_dat, manifest_folder, renishaw_rtl

SAMPLES = Path(__file__).parents[2] / "data" / "formats"
DAT, RTL = SAMPLES / "ecmc_dat.dat", SAMPLES / "renishaw_rtl.rtl"
REAL = Path(os.environ.get("ERRPIPE_REAL_DATA", Path(__file__).parents[4] / "shared/real-data")) / "iso230-linear-stage"


def test_a_path_is_recognised_by_its_beginning():
    assert formats.detect(DAT) is ecmc_dat
    assert formats.detect(RTL) is renishaw_rtl
    with pytest.raises(DataError, match="of no known format: the folder has no recording"):
        formats.detect(SAMPLES)
    with pytest.raises(DataError, match="no such file or folder"):
        formats.detect(SAMPLES / "nothing.dat")


@pytest.mark.parametrize("content", [b"", b"\x00\xff" * 500, b"HEADER::\n", b"run,t\n1,2\n"])
def test_nothing_strange_is_taken_for_a_format(tmp_path, content):
    (tmp_path / "x.bin").write_bytes(content)
    assert not any(f.sniff(tmp_path / "x.bin") for f in formats.FORMATS)


def test_options_and_names_are_checked():
    with pytest.raises(UsageError, match=r"no format is named 'ecmc' .* Did you mean ecmc_dat\?"):
        formats.read(DAT, "ecmc")
    with pytest.raises(
        UsageError, match=r"format ecmc_dat, axes: .* \(options: axis, directions\)\. Did you mean axis\?"
    ):
        formats.read(DAT, None, {"axes": "X"})


def test_rows_of_an_ecmc_file_come_in_the_order_of_measuring():
    frame = formats.read(DAT, options={"axis": "Z"}).frame
    assert list(frame) == ["run", "z", "direction", "EZZ"]
    first = frame[frame["run"] == "1"]
    np.testing.assert_array_equal(first["z"], [10, 20.5, 20.5, 10])
    np.testing.assert_array_equal(first["direction"], [1, 1, -1, -1])
    np.testing.assert_allclose(first["EZZ"], [20, -2, 2, 1], atol=1e-9)
    assert len(frame) == 12


def test_directions_can_be_swapped_where_someone_turned_the_labels():
    plain, swapped = formats.read(DAT).frame, formats.read(DAT, None, {"directions": "swapped"}).frame
    np.testing.assert_array_equal(swapped["direction"], -plain["direction"])
    np.testing.assert_array_equal(swapped["EXX"], plain["EXX"])


def test_other_units_of_an_ecmc_file(tmp_path):
    inch = tmp_path / "inch.dat"
    inch.write_text(DAT.read_text().replace("UNIT=mm", "UNIT=inch"))
    np.testing.assert_allclose(formats.read(inch).frame["EXX"], formats.read(DAT).frame["EXX"] * 25.4)
    np.testing.assert_allclose(formats.read(inch).frame["x"], formats.read(DAT).frame["x"] * 25.4)


WRONG_DAT = {
    "REF_DATA_FWD[1,2]=9.997": {
        "REF_DATA_FWD[1,2]=9,997": ":12  REF_DATA_FWD[1,2]: '9,997' is not a number",
        "REF_DATA_FWD[1]=9.997": ":12  REF_DATA_FWD[1]: REF_DATA_FWD is counted by [target,cycle]",
        "REF_DATA_FWD[2,1]=9.997": ":12  REF_DATA_FWD[2,1] occurs twice in the file",
        "": ": REF_DATA_FWD[1,2] is missing (POSITIONS=2, CYCLES=3)",
        "REF_DATA_FWD[1,2]=9.997\nREF_DATA_FWD[3,1]=3": ": REF_DATA_FWD[3,1] is beyond POSITIONS=2, CYCLES=3",
        "and now?": ":12  'and now?' is not KEY=value",
    },
    "UNIT=mm": {"UNIT=deg": ":4  UNIT: 'deg' is not a unit this format is read in (allowed: mm, um, m, inch)"},
    "CYCLES=3": {"CYCLES=many": ":5  CYCLES: 'many' is not a whole number"},
    "TGT_DATA[2]=20.5": {"": ": TGT_DATA[2] is missing (POSITIONS=2)"},
}


@pytest.mark.parametrize(("old", "new"), [(old, new) for old, news in WRONG_DAT.items() for new in news])
def test_a_wrong_ecmc_file_is_refused(tmp_path, old, new):
    path = tmp_path / "x.dat"
    path.write_text(DAT.read_text().replace(old, new))
    with pytest.raises(DataError) as refusal:
        formats.read(path, "ecmc_dat")
    assert str(refusal.value).startswith(f"{path}{WRONG_DAT[old][new]}")


def test_a_laser_file():
    recording = formats.read(RTL)
    frame = recording.frame
    assert list(frame) == ["run", "y", "direction", "EYY"]
    np.testing.assert_array_equal(frame["y"], [0, 100, 200, 300, 400, 500, 500, 400, 300, 200, 100, 0])
    np.testing.assert_array_equal(frame["direction"], [1] * 6 + [-1] * 6)
    np.testing.assert_array_equal(frame["EYY"], [0, -1.2, -2.5, -3.1, -3.9, -5, -4.1, -3, -2.2, -1.9, -0.4, 0.9])
    assert (recording.manifest.title, recording.names("error")) == ("six targets, one cycle", ("EYY",))
    assert formats.read(RTL, None, {"axis": "X"}).components() == ("EXX",)


WRONG_RTL = {
    ("Target-count: 6", "Target-count: 7"): ": Target-count is 7, but 6 targets are listed",
    ("1   4     -3.100", "1   7     -3.100"): ":31  target 7 does not exist (the file lists 6)",
    ("1   4     -3.100", "1   4     -3,100"): ":31  deviation: '-3,100' is not a number (a decimal comma?",
    ("1   4     -3.100", "1   4"): ":31  '1   4' is not a reading",
    ("EOF::", ""): ": the file does not end with EOF:: (it is cut short)",
    (
        "DEVIATIONS::",
        "DEVIATION::",
    ): ": no section DEVIATIONS:: (found: HEADER, TARGET DATA, USER-TEXT, RUNS, DEVIATION",
    ("Axis:Y", "Axis:vertical"): ": the file's axis is 'VERTICAL', not a linear ISO 841 axis (declare it: `axis: X`)",
    ("File type  : rtl", "File type  : rta"): ":2  'File type  : rta': not linear positioning",
    ("Owner      : Linear", "Owner      : Winkel"): ":3  'Owner      : Winkel': not linear positioning",
    ("1   2     -1.200", "1   6     -1.200"): ": run 1 visits its targets neither upwards nor downwards",
}


@pytest.mark.parametrize("change", WRONG_RTL)
def test_a_wrong_laser_file_is_refused(tmp_path, change):
    path = tmp_path / "x.rtl"
    path.write_bytes(RTL.read_bytes().replace(change[0].encode(), change[1].encode()))
    with pytest.raises(DataError) as refusal:
        formats.read(path, "renishaw_rtl")
    assert str(refusal.value).startswith(f"{path}{WRONG_RTL[change]}")


def test_an_angular_file_by_its_own_name_is_recognised_so_that_it_is_refused(tmp_path):
    """Else the importer of any table would read arcsec as um."""
    path = tmp_path / "x.rta"
    path.write_bytes(RTL.read_bytes().replace(b"File type  : rtl", b"File type  : rta"))
    with pytest.raises(DataError, match="not linear positioning"):
        formats.read(path)


def test_a_laser_file_in_an_old_code_page(tmp_path):
    path = tmp_path / "x.rtl"
    path.write_bytes(RTL.read_bytes().replace(b"By:errpipe", "By:J\xfcrgen".encode("cp1252")))
    assert len(formats.read(path)) == 12


@pytest.mark.parametrize("path", [DAT, RTL])
def test_what_was_read_can_be_written_and_read_again(tmp_path, path):
    recording = formats.read(path)
    manifest_folder.write(recording, tmp_path)
    again = manifest_folder.read(tmp_path)
    np.testing.assert_array_equal(again.frame.to_numpy(), recording.frame.to_numpy())
    assert again.manifest.columns == recording.manifest.columns


# ---------------------------------------------------------------- which way is up


@pytest.mark.realdata
@pytest.mark.skipif(not REAL.is_dir(), reason=f"the acceptance files are not at {REAL}")
def test_the_evidence_that_the_file_labels_its_directions_rightly():
    """A start-up transient dies away in the order of visiting: upwards in FWD; BWD has none (see formats.ecmc_dat)."""
    frame = formats.read(REAL / "ess.dat").frame
    table = frame.pivot_table(index=["direction", "x"], columns="run", values="EXX")
    departure = (table["1"] - table[["2", "3", "4", "5"]].mean(axis=1)).to_numpy().reshape(2, 5)
    down, up = departure
    np.testing.assert_allclose(up, [114.45, 48.21, 3.36, -4.53, -6.26], atol=0.01)
    assert np.abs(down).max() < 8
    for sample, mean in (("ess", -13.8), ("psi", -0.0054)):
        frame = formats.read(REAL / f"{sample}.dat").frame
        later = frame[frame["run"] != "1"] if sample == "ess" else frame
        by = later.groupby("direction")["EXX"].mean()
        assert by[1.0] - by[-1.0] == pytest.approx(mean, rel=0.02)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_a_laser_file_in_utf_16(tmp_path, encoding):
    path = tmp_path / "x.rtl"
    path.write_bytes(RTL.read_text().replace("\n", "\r\n").encode(encoding))
    np.testing.assert_array_equal(formats.read(path).frame.to_numpy(), formats.read(RTL).frame.to_numpy())


def test_a_laser_file_with_decimal_commas(tmp_path):
    """All of its numbers have them; one with a point beside is refused above."""
    path = tmp_path / "x.rtl"
    head, data = RTL.read_text().split("TARGET DATA::")
    numbers, rest = data.split("ENVIRONMENT::")
    path.write_text(f"{head}TARGET DATA::{numbers.replace('.', ',')}ENVIRONMENT::{rest}")
    np.testing.assert_array_equal(formats.read(path).frame.to_numpy(), formats.read(RTL).frame.to_numpy())


@pytest.mark.parametrize("word", ["Axe Y", "Y-Achse", "Y axis", "eje Y", "Achse Y", "y"])
def test_the_letter_of_an_axis_next_to_its_word(tmp_path, word):
    path = tmp_path / "x.rtl"
    path.write_text(RTL.read_text().replace("Axis:Y", f"Axis:{word}"))
    assert formats.read(path).components() == ("EYY",)
