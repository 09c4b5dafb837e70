"""Archives of several files, INI files, and files that state a sign, an axis or a block of rows once."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing import archives
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared


def of_run(run: str) -> str:
    rows = [f"{x},{side:g},{d}" for r, x, side, d in long_rows() if r == run]
    return "\n".join(["X [mm],direction,deviation [um]", *rows]) + "\n"


def zipped(path: Path, files: dict[str, str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


def tarred(path: Path, files: dict[str, str], mode: str = "w:gz") -> Path:
    with tarfile.open(path, mode) as archive:  # type: ignore[call-overload]
        for name, text in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(text.encode())
            archive.addfile(info, io.BytesIO(text.encode()))
    return path


RUNS = {f"export/run{r}.csv": of_run(r) for r in ("3", "1", "2")}


@pytest.mark.parametrize("suffix", ["zip", "tar", "tar.gz", "tgz"])
def test_each_file_of_an_archive_is_a_run(tmp_path: Path, suffix: str) -> None:
    files = RUNS | {"export/readme.txt": "to the laboratory", "__MACOSX/export/._run1.csv": "of a system"}
    path = tmp_path / f"laser.{suffix}"
    path = zipped(path, files) if suffix == "zip" else tarred(path, files, "w" if suffix == "tar" else "w:gz")
    recording = imported(tmp_path, path)
    assert list(dict.fromkeys(recording.frame["run"])) == ["run1", "run2", "run3"]
    for number, part in enumerate(recording.frame.groupby("run", sort=False), start=1):
        (error,) = recording.names("error", component="EXX")
        assert part[1][error].to_numpy() == pytest.approx([d for r, *_, d in long_rows() if r == str(number)])
    assert "laser" in prepared([path])[0].notes[0] and "readme.txt" in prepared([path])[0].notes[0]


def test_runs_of_an_archive_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    files, _ = archives.unpacked(
        zipped(tmp_path / "a.zip", {f"run {n}.csv": "x" for n in (10, 2, 9, 1)}), tmp_path / "o"
    )
    assert [f.stem for f in files] == ["run 1", "run 2", "run 9", "run 10"]


@pytest.mark.parametrize("name", ["../run1.csv", "/etc/run1.csv", "a/../../run1.csv", "..\\run1.csv", "c:/run1.csv"])
def test_a_file_outside_its_archive_is_refused(tmp_path: Path, name: str) -> None:
    for path in (zipped(tmp_path / "a.zip", {name: of_run("1")}), tarred(tmp_path / "a.tar.gz", {name: of_run("1")})):
        with pytest.raises(DataError, match=rf"{path.name}: .*is a place outside the archive"):
            prepared([path])


def test_a_link_in_an_archive_and_too_many_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with tarfile.open(tmp_path / "l.tar", "w") as archive:
        link = tarfile.TarInfo("x.csv")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/hosts"
        archive.addfile(link)
    with pytest.raises(DataError, match=r"l\.tar: x\.csv is a link"):
        prepared([tmp_path / "l.tar"])
    with pytest.raises(DataError, match=r"'run\?1\.csv' is in it twice"):
        prepared([zipped(tmp_path / "t.zip", {"run_1.csv": of_run("1"), "run?1.csv": of_run("2")})])
    with pytest.raises(DataError, match="not an archive that can be read"):
        prepared([zipped(tmp_path / "o.zip", {"a": "x", "a/b": "y"})])
    monkeypatch.setattr(archives, "MOST_MEMBERS", 2)
    for name in RUNS:
        (tmp_path / "m" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "m" / name).write_text("x")
    for path in (zipped(tmp_path / "m.zip", RUNS), tarred(tmp_path / "m.tgz", RUNS), tmp_path / "m"):
        with pytest.raises(DataError, match="it holds more than 2 files"):
            prepared([path])
    monkeypatch.setattr(archives, "MOST_MEMBERS", 9)
    monkeypatch.setattr(archives, "MOST_BYTES", 10_000)
    bomb = {"x.csv": "0" * 100_000}
    for path in (zipped(tmp_path / "b.zip", bomb), tarred(tmp_path / "b.tgz", bomb)):
        with pytest.raises(DataError, match="unpacked"):
            prepared([path])


def test_a_question_on_a_file_of_an_archive_names_both(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"^\S*runs\.zip, a/x2\.csv: x2: no row with two numbers"):
        prepared([zipped(tmp_path / "runs.zip", {"a/x1.csv": of_run("1"), "a/x2.csv": "no table\n"})])


@pytest.mark.parametrize("between", [[], ["", ""], [";;"]])
def test_targets_that_start_again_below_are_another_run(tmp_path: Path, between: list[str]) -> None:
    """Targets with a column each for up and down, three times below each other, were one run."""
    lines = ["Target [mm];Up [um];Down [um]"]
    for run in (1, 2, 3):
        up, down = deviation(run, 1.0), deviation(run, -1.0)
        lines += [f"{x};{up[i]};{down[i]}" for i, x in enumerate(TARGETS)] + between
    (tmp_path / "x.csv").write_text("\n".join(lines) + "\n")
    holds_the_truth(imported(tmp_path, tmp_path / "x.csv"))


def test_runs_in_columns_and_below_each_other_stay_apart(tmp_path: Path) -> None:
    lines = ["Target [mm];Run 1 [um];Run 2 [um]"]
    lines += [f"{x};{k + 10 * day};{k + 10 * day + 1}" for day in (1, 2) for k, x in enumerate(TARGETS)]
    (tmp_path / "x.csv").write_text("\n".join(lines) + "\n")
    assert sorted(set(imported(tmp_path, tmp_path / "x.csv").frame["run"])) == ["1-1", "1-2", "2-1", "2-2"]


def ini(form: str) -> str:
    rows = [row for row in long_rows() if row[0] == "1" and row[2] > 0]
    head = "; a test\n[Machine]\nName=VMC\nAxis=X\n"
    if form == "points":
        return head + "".join(f"[Point{k}]\nTarget_mm={r[1]}\nDeviation_um={r[3]}\n" for k, r in enumerate(rows))
    columns = {"Targets_mm": [r[1] for r in rows], "Deviations_um": [r[3] for r in rows]}
    if form == "columns":
        parts = (f"[{n}]\n" + "".join(f"P{k}={v}\n" for k, v in enumerate(of)) for n, of in columns.items())
        return head + "".join(parts)
    return head + "".join(f"{n} = {'; '.join(map(str, of))}\n" for n, of in columns.items())


@pytest.mark.parametrize("form", ["points", "columns", "lists"])
def test_an_ini_file_of_a_test(tmp_path: Path, form: str) -> None:
    (tmp_path / "m.ini").write_text(ini(form))
    recording = imported(tmp_path, tmp_path / "m.ini")
    assert recording.array(recording.name("position")) == pytest.approx(TARGETS)
    (error,) = recording.names("error", component="EXX")
    assert recording.array(error) == pytest.approx(deviation(1, 1.0))


def test_settings_of_a_control_are_no_measurement(tmp_path: Path) -> None:
    joints = "".join(f"[JOINT_{n}]\nTYPE = LINEAR\nHOME = {n}.0\nBACKLASH = 0.0{n}\nFERROR = {n}.1\n" for n in range(3))
    (tmp_path / "mill.ini").write_text(f"[EMC]\nMACHINE = mill\n{joints}")
    with pytest.raises(DataError, match="no column holds a deviation"):
        prepared([tmp_path / "mill.ini"])


def test_a_sign_that_one_of_the_files_states_asks_for_the_option(tmp_path: Path) -> None:
    for run in ("1", "2", "3"):
        line = "# deviation = target - actual\n" if run == "1" else ""
        (tmp_path / f"X_{run}.csv").write_text(line + of_run(run))
    files = [tmp_path / f"X_{r}.csv" for r in ("1", "2", "3")]
    with pytest.raises(
        DataError, match=r"X_1: 'deviation' is commanded minus actual .*X_2 does not.*--sign commanded-min"
    ):
        prepared(files)
    recording = imported(tmp_path, files, sign="commanded-minus-actual")
    (error,) = recording.names("error", component="EXX")
    assert recording.array(error) == pytest.approx([-d for *_, d in long_rows()])


def test_the_component_settles_an_axis_that_the_file_name_contradicts(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t [s],Z drift [um]\n" + "".join(f"{10 * k},{k / 10}\n" for k in range(9)))
    with pytest.raises(DataError, match="names the axis X, a column Z"):
        prepared([tmp_path / "x.csv"])
    recording = imported(tmp_path, tmp_path / "x.csv", component="E_Z")
    assert recording.names("error", component="E_Z")


def test_the_axis_in_brackets_and_the_lag_of_an_axis(tmp_path: Path) -> None:
    t, x = np.arange(40), np.round(100 + 50 * np.sin(np.arange(40) / 8), 4)
    lag = np.round(np.sin(t / 5), 3)
    rows = [f"{2 * k};{x[k]};{x[k] + lag[k]:.4f}" for k in t]
    (tmp_path / "t.csv").write_text("\n".join(["t [ms];cmdPos[Z1] [mm];actPos[Z1] [mm]", *rows]) + "\n")
    recording = imported(tmp_path, tmp_path / "t.csv")
    assert recording.array(*recording.names("error", component="EZZ")) == pytest.approx(1e3 * lag, abs=1e-6)
    for name in ("Z_lag_mm", "Z_followErr_mm"):
        (tmp_path / "l.csv").write_text(
            "\n".join([f"t_ms;Z_cmd_mm;{name}", *(f"{2 * k};{x[k]};{lag[k]}" for k in t)]) + "\n"
        )
        recording = imported(tmp_path / name, tmp_path / "l.csv")
        assert recording.array(*recording.names("error", component="EZZ")) == pytest.approx(-1e3 * lag, abs=1e-6)


def test_a_grid_encoder_reads_the_tool_point(tmp_path: Path) -> None:
    angle = np.radians(np.arange(0, 360, 10.0))
    x, y = np.round(40 * np.cos(angle), 4), np.round(40 * np.sin(angle), 4)
    rows = [f"{a};{b};{a + 0.003:.4f};{b - 0.002:.4f}" for a, b in zip(x, y, strict=True)]
    lines = ["KGM 182", "X nominal [mm];Y nominal [mm];X actual [mm];Y actual [mm]", *rows]
    (tmp_path / "k.txt").write_text("\n".join(lines) + "\n")
    recording = imported(tmp_path, tmp_path / "k.txt")
    for component, value in (("E_X", 3.0), ("E_Y", -2.0)):
        (name,) = recording.names("error", component=component)
        assert recording.array(name) == pytest.approx(np.full(36, value), abs=1e-6)
    assert recording.manifest.constants["protocol"].value == "point_cloud" and not recording.names("direction")
    (tmp_path / "k.txt").write_text("\n".join(lines[1:]) + "\n")
    with pytest.raises(DataError, match="move together"):
        prepared([tmp_path / "k.txt"])


def test_runs_of_a_nested_document(tmp_path: Path) -> None:
    lines = ["axis: X", "runs:"]
    for run in ("1", "2", "3"):
        points = [
            f"      - {{X_mm: {x}, direction: {s:g}, deviation_um: {d}}}" for r, x, s, d in long_rows() if r == run
        ]
        lines += [f"  - number: {run}", "    points:", *points]
    (tmp_path / "x.yaml").write_text("\n".join(lines) + "\n")
    recording = imported(tmp_path, tmp_path / "x.yaml")
    assert len(set(recording.frame["run"])) == 3 and len(recording) == len(long_rows())


def test_a_query_of_a_cloud_has_a_row_per_value(tmp_path: Path) -> None:
    """As Timestream answers: the type behind the name of the values."""
    lines = ["machine,measure_name,time,measure_value::double"]
    for k in range(12):
        time = f"2023-03-12 11:{k:02d}:00.000000000"
        lines += [f"m4,z_displacement_um,{time},{k / 4}", f"m4,spindle_temperature_degC,{time},{20 + k}"]
    (tmp_path / "q.csv").write_text("\n".join(lines) + "\n")
    recording = imported(tmp_path, tmp_path / "q.csv", component="E_Z")
    assert recording.array(*recording.names("error", component="E_Z")) == pytest.approx(np.arange(12) / 4)
    assert recording.array(*recording.names("temperature")) == pytest.approx(20.0 + np.arange(12))


def test_both_sides_of_a_target_in_rows_below_each_other_are_one_run(tmp_path: Path) -> None:
    """Each target once from below, once from above, with a column per run: each target became a run of its own."""
    lines = ["Target [mm];Direction;Run 1 [um];Run 2 [um];Run 3 [um]"]
    for i, x in enumerate(TARGETS):
        lines += [f"{x};{s:+g};" + ";".join(str(deviation(r, s)[i]) for r in (1, 2, 3)) for s in (1.0, -1.0)]
    (tmp_path / "x.csv").write_text("\n".join(lines) + "\n")
    recording = imported(tmp_path, tmp_path / "x.csv")
    holds_the_truth(recording)
    assert len(set(recording.frame["run"])) == 3


def test_targets_in_any_order_are_one_run(tmp_path: Path) -> None:
    targets = [300, 50, 450, 0, 150, 500, 200, 400, 100, 350, 250]
    lines = ["Target X [mm];Up [um];Down [um]", *(f"{x};{x / 50};{x / 50 + 3}" for x in targets)]
    (tmp_path / "x.csv").write_text("\n".join(lines) + "\n")
    assert len(set(imported(tmp_path, tmp_path / "x.csv").frame["run"])) == 1


def test_a_folder_packed_with_its_dot_is_an_archive(tmp_path: Path) -> None:
    path = tarred(tmp_path / "d.tgz", {f"./{name}": text for name, text in RUNS.items()} | {"./.hidden": "x"})
    assert len(set(imported(tmp_path, path).frame["run"])) == 3


def test_a_sparse_file_an_encrypted_one_and_documents_are_refused(tmp_path: Path) -> None:
    head = tarfile.TarInfo("s.csv")
    head.type, head.size = tarfile.GNUTYPE_SPARSE, 512
    block = bytearray(head.tobuf(tarfile.GNU_FORMAT))
    block[386:410] = b"%011o\0%011o\0" % (0, 512)  # its only data
    block[483:495] = b"%011o\0" % (3 << 30)  # bytes unpacked
    block[148:156] = b"%06o\0 " % (256 + sum(block[:148]) + sum(block[156:]))
    (tmp_path / "s.tar").write_bytes(bytes(block) + b"1,2\n" * 128 + bytes(1024))
    with pytest.raises(DataError, match=r"s\.tar: more than 256 MB unpacked"):
        prepared([tmp_path / "s.tar"])
    whole = bytearray(zipped(tmp_path / "e.zip", {"run.csv": of_run("1")}).read_bytes())
    for at in (6, whole.rindex(b"PK\x01\x02") + 8):  # the flags, in both headers
        whole[at] |= archives.ENCRYPTED
    (tmp_path / "e.zip").write_bytes(whole)
    with pytest.raises(DataError, match=r"e\.zip: run\.csv is encrypted"):
        prepared([tmp_path / "e.zip"])
    for name, inside in (("a.docx", "[Content_Types].xml"), ("a.odt", "mimetype"), ("a.fmu", "modelDescription.xml")):
        with pytest.raises(DataError, match=rf"{name}: neither text nor any other kind"):
            prepared([zipped(tmp_path / name, {inside: "<a/>", "b.csv": of_run("1")})])
