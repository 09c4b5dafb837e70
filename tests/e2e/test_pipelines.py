"""Whole runs, as a user starts them: from recordings to a verified table and a report, with the figures to reach."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.formats import manifest_folder
from errpipe.tables import ect
from errpipe.tables.reference import Evaluator

ROOT = Path(__file__).parents[2]
REAL = Path(os.environ.get("ERRPIPE_REAL_DATA", ROOT.parent / "shared" / "real-data"))

real = [
    pytest.mark.realdata,
    pytest.mark.slow,
    pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings (ERRPIPE_REAL_DATA) are not here"),
]


@pytest.fixture
def at_root(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("ERRPIPE_REAL_DATA", str(REAL))


def run(pipeline, out, *more):
    assert main(["run", str(pipeline), "--out", str(out), *more]) == 0
    return json.loads((out / "validate" / "validation.json").read_text())


def figures(document, component):
    return next(c for c in document["components"] if c["component"] == component)


def machine_too_long(folder):
    """A machine that is 10 um too long at X = +500 and right at X = 0, measured five times in both directions."""
    x = np.tile(np.r_[np.linspace(0, 500, 11), np.linspace(500, 0, 11)], 5)
    side = np.tile(np.r_[np.ones(11), -np.ones(11)], 5)
    run = np.repeat([str(n) for n in range(1, 6)], 22)
    noise = np.random.default_rng(3).normal(0.0, 0.05, x.size)
    frame = pd.DataFrame(
        {"run": run, "t": np.arange(x.size) * 10.0, "x": x, "dir": side, "EXX": 10.0 * x / 500.0 + noise}
    )
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "dir": Column(role="direction", axis="X"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    constants = {"X": Constant(role="axis", kind="linear", travel=(0, 500), unit="mm")}
    manifest = Manifest(recording=1, machine="m", tables=("recording.parquet",), columns=columns, constants=constants)
    manifest_folder.write(Recording(manifest, frame), folder)


PIPELINE = """pipeline: 1
title: A machine 10 um too long at +X
stages:
  - {kind: ingest, recording: recording}
  - kind: fit
    components: [{component: EXX, terms: [{term: offset}, {term: scale_error, axis: X}]}]
  - kind: validate
  - kind: export
    targets: [linuxcnc_screw, sinumerik_lec, beckhoff_ssfk, twincat_nc_table, smoothie_pitch]
  - kind: report
"""


def test_a_machine_10_um_too_long_is_commanded_10_um_less_far(tmp_path, capsys):
    """From the recording to the controller's file, the sign survives every step."""
    machine_too_long(tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(PIPELINE)
    document = run(tmp_path / "p.yaml", tmp_path / "out")
    assert figures(document, "EXX")["rms_after"] < 0.1
    evaluator = Evaluator(ect.read(tmp_path / "out" / "export" / "table.ect"))
    cycle = evaluator.cycle({"x": 500.0})
    assert cycle.deviation["EXX"] == pytest.approx(10.0, abs=0.1)
    far = float((tmp_path / "out/export/linuxcnc_screw/x.comp").read_text().split("\n")[-2].split()[1])
    near = float((tmp_path / "out/export/linuxcnc_screw/x.comp").read_text().split("\n")[0].split()[1])
    assert far - near == pytest.approx(-0.010, abs=2e-4)
    assert main(["verify", str(tmp_path / "out" / "export")]) == 0
    assert main(["eval", str(tmp_path / "out/export/table.ect"), "--at", "x=500"]) == 0
    assert "correction -0.0" in capsys.readouterr().out


def test_a_spoilt_export_is_found(tmp_path):
    machine_too_long(tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(PIPELINE)
    run(tmp_path / "p.yaml", tmp_path / "out")
    spoilt = tmp_path / "out" / "export" / "linuxcnc_screw" / "x.comp"
    good = spoilt.read_text()
    spoilt.write_text(good.replace(" -0.00", " 0.00"))
    assert main(["verify", str(tmp_path / "out" / "export")]) == 6
    spoilt.write_text(good)
    table = tmp_path / "out" / "export" / "table.ect"
    data = bytearray(table.read_bytes())
    data[700] ^= 1
    table.write_bytes(bytes(data))
    assert main(["verify", str(tmp_path / "out" / "export")]) == 6


def test_a_model_no_better_than_nothing_is_not_exported(tmp_path, capsys):
    """Pure noise: the gate says no, and no table is left behind."""
    machine_too_long(tmp_path / "recording")
    recording = manifest_folder.read(tmp_path / "recording")
    noise = np.random.default_rng(5).normal(0.0, 1.0, len(recording))
    manifest_folder.write(Recording(recording.manifest, recording.frame.assign(EXX=noise)), tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(PIPELINE)
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 4
    assert "not better than no compensation on held-out rows" in capsys.readouterr().err
    assert not (tmp_path / "out" / "export" / "table.ect").exists()


@pytest.mark.slow
def test_demo_then_nothing_to_do(tmp_path, capsys, at_root):
    assert main(["demo", "--out", str(tmp_path / "demo")]) == 0
    first = capsys.readouterr().out
    assert "noise floor" in first and (tmp_path / "demo" / "report" / "report.html").is_file()
    document = json.loads((tmp_path / "demo" / "validate" / "validation.json").read_text())
    values = figures(document, "EXX")
    assert values["rms_after"] < 0.1 * values["rms_before"]
    stamps = {p: p.stat().st_mtime_ns for p in (tmp_path / "demo").rglob("*") if p.is_file()}
    assert main(["demo", "--out", str(tmp_path / "demo")]) == 0
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "demo").rglob("*") if p.is_file()} == stamps


@pytest.mark.slow
def test_a_machine_identified_and_compiled(tmp_path, at_root):
    """The truth behind the simulated point clouds lies in its intervals, and the table gives the machine back."""
    from errpipe import yamlfile
    from errpipe.domain.machine import Machine
    from errpipe.kinematics.chain import compile_chain
    from errpipe.simulation import metrology

    out = tmp_path / "out"
    assert main(["run", "pipelines/vertical-centre-volumetric.yaml", "--out", str(out)]) == 0
    document = json.loads((out / "identify" / "identification.json").read_text())
    chain = compile_chain(yamlfile.load(ROOT / "examples" / "machines" / "vertical-centre.yaml", Machine))
    truth = metrology.smooth_machine(chain, 1)
    inside = [c["ci95"][0] <= truth[c["component"]] <= c["ci95"][1] for c in document["constants"]]
    assert len(inside) == 3 and sum(inside) >= 2
    assert document["unseen"] == [] and document["volumetric"]["standard_error_um"] < 2.0
    exported = json.loads((out / "export_volumetric" / "export.json").read_text())
    assert exported["proof"][0]["largest_difference_um"] < exported["proof"][0]["bound_um"] < 0.05
    lattice = exported["lattice"]
    assert lattice["largest_seen_um"] <= lattice["bound_um"] < 2.2
    rows = pd.read_csv(out / "export_volumetric" / "lattice.csv")
    assert len(rows) == 17 * 11 * 11 and list(rows) == ["X", "Y", "Z", "E_X", "E_Y", "E_Z"]
    assert document["simulated_truth"]["after_rms_um"] < 1.2 * document["volumetric"]["standard_error_um"]
    assert main(["verify", str(out / "export_volumetric")]) == 0


SEASONS = "pipelines/turning-centre-seasons.yaml"


@pytest.fixture(scope="module")
def seasons(tmp_path_factory):
    """One run of the pipeline of the seasons; who changes an option runs on in a copy, and fits nothing again."""
    out = tmp_path_factory.mktemp("seasons") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setenv("ERRPIPE_REAL_DATA", str(REAL))
        run(SEASONS, out)
    return out


class TestReal:
    pytestmark = real

    @pytest.mark.xdist_group("seasons")
    def test_turning_centre_over_seasons(self, seasons, tmp_path):
        """A season left out whole: at most 10 um in winter, below 8.7 in spring (doing nothing); table equals fit."""
        document = json.loads((seasons / "validate" / "validation.json").read_text())
        groups = {g["left_out"]: g for g in document["seasons"]["groups"]}
        assert groups["winter"]["out_of_season"] <= 10.0
        assert groups["spring"]["out_of_season"] < 8.7
        assert document["seasons"]["never_worse"]
        assert document["forward"]["never_worse"]  # retrained by the month
        for month in document["forward_daily"]["months"]:  # retrained every day; single days may still lose
            assert month["out_of_season"] < 0.8 * month["uncompensated"], month["month"]
        assert all(0.85 < g["coverage"] < 0.99 for g in groups.values())
        recording = REAL / "turning-centre-thermal"
        for source in ("table.ect", "error_model.json"):
            table = str(seasons / "export" / source)
            assert main(["predict", table, str(recording), "--out", str(tmp_path / f"{source}.csv")]) == 0
        by_table, by_model = (pd.read_csv(tmp_path / f"{s}.csv") for s in ("table.ect", "error_model.json"))
        gap = by_table["dia_disp_predicted"] - by_model["dia_disp_predicted"]
        assert len(by_table) == 4686
        assert np.abs(gap).max() < 1e-3

    @pytest.mark.xdist_group("seasons")
    def test_prediction_is_causal(self, seasons, tmp_path):
        """Rows after k do not change what is predicted at k."""
        whole = manifest_folder.read(REAL / "turning-centre-thermal")
        one = whole.take(whole.run_codes() == 3)
        for name, rows in (("long", len(one)), ("short", 60)):
            manifest_folder.write(one.take(np.arange(rows)), tmp_path / name)
            table = str(seasons / "export" / "table.ect")
            assert main(["predict", table, str(tmp_path / name), "--out", str(tmp_path / f"{name}.csv")]) == 0
        long, short = (pd.read_csv(tmp_path / f"{n}.csv") for n in ("long", "short"))
        pd.testing.assert_frame_equal(long.iloc[:60], short)

    @pytest.mark.xdist_group("seasons")
    def test_a_guarded_table_stands_in_for_a_failed_sensor(self, seasons, tmp_path, at_root):
        """Each sensor reads zero from the third hour on: the guarded table stays near its healthy residual.

        The table knows these runs, so that the healthy residual is small. What the room does no other sensor tells.
        """
        from errpipe.thermal.arithmetic import since_start

        recording = manifest_folder.read(REAL / "turning-centre-thermal")
        recording = recording.take(recording.run_codes() % 4 == 1)
        truth, _ = since_start(recording.array("dia_disp"), recording.run_codes(), 3)
        begun = recording.frame.groupby("run")["t"].transform("min").to_numpy()
        late = recording.time() - begun > 7200.0

        def left(table, frame):
            manifest_folder.write(Recording(recording.manifest, frame), tmp_path / "rows")
            assert main(["predict", str(table), str(tmp_path / "rows"), "--out", str(tmp_path / "p.csv")]) == 0
            output = pd.read_csv(tmp_path / "p.csv")["dia_disp_predicted"].to_numpy()
            return float(np.sqrt(np.nanmean((truth - output) ** 2)))

        tables = {}
        for guard in ("true", "false"):
            out = shutil.copytree(seasons, tmp_path / guard)
            run(SEASONS, out, "--set", f"export.guard={guard}")
            tables[guard] = out / "export" / "table.ect"
        healthy = left(tables["true"], recording.frame)
        for sensor in recording.names("temperature"):
            failed = recording.frame.assign(**{sensor: np.where(late, 0.0, recording.array(sensor))})
            guarded, bare = left(tables["true"], failed), left(tables["false"], failed)
            assert guarded < (2.3 if sensor == "T_ambient" else 1.4) * healthy, sensor
            assert guarded < 0.5 * bare, sensor

    def test_drilled_plates(self, tmp_path, at_root):
        """Whole plates are held out: the map of one plate does not carry over to another one, and the gate says so."""
        document = run("pipelines/drilled-plates.yaml", tmp_path / "out")
        assert document["scheme"] == "leave-one-run-out"
        for component in ("E_X", "E_Y"):
            assert figures(document, component)["rms_after"] > figures(document, component)["rms_before"] > 5.0
            assert figures(document, component)["verdict"] != "model"
        plate = json.loads((tmp_path / "out" / "fit" / "plate.json").read_text())
        assert {"C0Y", "scale_difference"} <= set(plate["figures"])
        floor = plate["measured_twice"]
        assert floor["holes"] > 600 and 1.0 < floor["smooth"] < floor["floor"] < 3.0
        page = (tmp_path / "out" / "report" / "report.html").read_text()
        assert "Residual and metrology floor" in page and "scale_difference" in page

    def test_gantry_with_two_sources(self, tmp_path, at_root):
        """Frame and bed, held out by blocks of time: about 5 um where the frame alone leaves about 37."""
        document = run("pipelines/gantry-frame.yaml", tmp_path / "out")
        assert figures(document, "E_Z")["rms_after"] < 6.0

    def test_linear_stage_after_iso_230_2(self, tmp_path, at_root):
        document = run("pipelines/iso230-linear-stage.yaml", tmp_path / "out")
        assert document["iso230_2"]["A"] == pytest.approx(204.76, abs=0.01)  # as its acceptance tool says
        assert figures(document, "EXX")["rms_after"] < figures(document, "EXX")["rms_before"]
