"""`errpipe diagnose` from the command line beside each kind of simulation, and with input that cannot be used."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.simulation import folder

GAIN, TAU = 2.6, 900.0  # what the machine does; the FMU starts at 2 um/K and 600 s


def drift(backlash: float = 0.0, twin: bool = False) -> Recording:
    """A part that follows a temperature rise late and grows; the table goes to and fro."""
    t = np.arange(0.0, 12000.0, 20.0)
    rise = 2 + 8 * (1 - np.exp(-t / 1500)) + 2 * np.sin(t / 900)
    late = np.zeros_like(t)
    for k in range(1, t.size):
        late[k] = late[k - 1] + (rise[k - 1] - late[k - 1]) * (1 - np.exp(-20.0 / TAU))
    side = np.where(np.arange(t.size) // 10 % 2, -1.0, 1.0)
    x = 200 + 10.0 * np.where(side > 0, np.arange(t.size) % 10, 9 - np.arange(t.size) % 10)
    noise = 0.2 * np.random.default_rng(3).standard_normal(t.size)
    columns = {"t": t, "x": x, "dir": side, "rise": 20 + rise, "EXX": GAIN * late - backlash / 2 * side + noise}
    kinds = {
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "dir": Column(role="direction", axis="X"),
        "rise": Column(role="temperature", unit="degC"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    if twin:
        columns["EXX_sim"] = GAIN * late
        kinds["EXX_sim"] = Column(role="simulated", component="EXX", unit="um")
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), pd.DataFrame(columns))


class Done(NamedTuple):
    """How a command line ended."""

    returncode: int
    stdout: str
    stderr: str


def run(tmp_path: Path, recording: Recording, *arguments: str) -> tuple[Done, dict]:
    """The command on a recording, in this process and with `tmp_path` as its folder, and the diagnosis it wrote."""
    folder.write(tmp_path / "in", recording)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(tmp_path), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(["diagnose", "in", "--out", "out", *arguments])
    file = tmp_path / "out/diagnosis.json"
    return Done(code, out.getvalue(), err.getvalue()), json.loads(file.read_text()) if file.exists() else {}


def first(diagnosis: dict) -> str:
    return diagnosis["responses"][0]["findings"][0]["effect"]


@pytest.mark.slow
def test_next_to_its_own_simulated_column(tmp_path: Path) -> None:
    done, result = run(tmp_path, drift(6.0, twin=True))
    assert done.returncode == 0 and first(result) in ("backlash", "friction_hysteresis")
    assert (tmp_path / "out/report.html").stat().st_size > 10_000


def test_next_to_a_csv_on_a_clock_of_its_own(tmp_path: Path) -> None:
    """Simulated every 7 s: values are drawn straight between the rows of the file."""
    whole = drift(6.0, twin=True)
    t = np.arange(0.0, 12000.0, 7.0)
    simulated = np.interp(t, whole.time(), whole.array("EXX_sim"))
    pd.DataFrame({"time": t, "EXX": simulated}).to_csv(tmp_path / "sim.csv", index=False)
    done, result = run(tmp_path, drift(6.0), "--simulation", "sim.csv")
    assert done.returncode == 0, done.stderr
    assert first(result) in ("backlash", "friction_hysteresis")


@pytest.mark.slow
def test_next_to_an_error_model_fitted_here(tmp_path: Path) -> None:
    from errpipe.fitting import model
    from errpipe.fitting.spec import ModelSpec
    from errpipe.stages._artefacts import model_json

    terms = [{"term": "offset"}, {"term": "thermal_lag", "sensor": "rise"}]
    spec = ModelSpec.model_validate({"components": [{"component": "EXX", "terms": terms}]})
    (tmp_path / "model.json").write_text(json.dumps(model_json(model.fit(drift(6.0), spec))))
    done, result = run(tmp_path, drift(6.0), "--simulation", "model.json")
    assert done.returncode == 0, done.stderr
    assert first(result) in ("backlash", "friction_hysteresis")


FMU = """
import math
from pythonfmu import Fmi2Causality as C, Fmi2Slave, Fmi2Variability as V, Real

class Model(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.rise, self.gain, self.tau, self.EXX, self.state = 20.0, 2.0, 600.0, 0.0, 0.0
        self.register_variable(Real("rise", causality=C.input, start=20.0))
        for name, start in (("gain", 2.0), ("tau", 600.0)):
            self.register_variable(Real(name, causality=C.parameter, variability=V.tunable, start=start))
        self.register_variable(Real("EXX", causality=C.output))

    def do_step(self, t, dt):
        self.state += (self.rise - 20.0 - self.state) * (1 - math.exp(-dt / self.tau))
        self.EXX = self.gain * self.state
        return True
"""


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if importlib.util.find_spec("pythonfmu") is None:
        pytest.skip("pythonfmu builds the FMU")
    where = tmp_path_factory.mktemp("fmu")
    (where / "model.py").write_text(FMU)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "model.py", "-d", "."]
    subprocess.run(command, cwd=where, check=True, capture_output=True)
    return where / "Model.fmu"


@pytest.mark.slow
def test_an_fmu_is_set_right_before_anything_is_called_missing(tmp_path: Path, fmu: Path) -> None:
    done, result = run(tmp_path, drift(), "--simulation", str(fmu), "--apply", "better")
    assert done.returncode == 0, done.stderr
    assert result["responses"][0]["verdict"] in ("no_mismatch", "recalibrate")
    lines = (tmp_path / "better/parameters.yaml").read_text().splitlines()
    set_right = {name: float(value) for name, value in (line.split("#")[0].split(": ") for line in lines)}
    assert abs(set_right["gain"] - GAIN) < 0.1 and abs(set_right["tau"] - TAU) < 60
    output = " ".join(result["notes"])
    assert "gain recalibrated" in output and "tau recalibrated" in output and "2 -> 2.6" in output
    assert str(tmp_path) not in output


@pytest.mark.slow
def test_what_an_fmu_cannot_mend_is_missing(tmp_path: Path, fmu: Path) -> None:
    done, result = run(tmp_path, drift(6.0), "--simulation", str(fmu))
    assert done.returncode == 0, done.stderr
    assert first(result) in ("backlash", "friction_hysteresis")


# ---------------------------------------------------------------- input that cannot be used


def without(recording: Recording, *names: str) -> Recording:
    kinds = {n: c for n, c in recording.manifest.columns.items() if n not in names}
    return Recording(recording.manifest.model_copy(update={"columns": kinds}), recording.frame.drop(columns=[*names]))


def in_urad(recording: Recording) -> Recording:
    kinds = dict(recording.manifest.columns)
    kinds["EXX_sim"] = Column(role="simulated", component="EXX", unit="urad")
    return Recording(recording.manifest.model_copy(update={"columns": kinds}), recording.frame)


def constant(recording: Recording, name: str, value: float) -> Recording:
    return Recording(recording.manifest, recording.frame.assign(**{name: value}))


UNUSABLE = {
    "no simulated twin": (lambda r: without(r, "EXX_sim"), "EXX: no column of role simulated for it"),
    "units that differ": (in_urad, "EXX is measured in um (found 'urad')"),
    "three rows": (lambda r: r.take(np.arange(3)), "only 3 rows hold both a recorded and a simulated value"),
    "all missing": (lambda r: constant(r, "EXX", np.nan), "only 0 rows hold both"),
    "nothing simulated": (lambda r: constant(r, "EXX_sim", np.nan), "only 0 rows hold both"),
    "a constant response": (lambda r: constant(r, "EXX", 1.0), "the recorded value never changes"),
}


@pytest.mark.parametrize("what", UNUSABLE)
def test_input_that_cannot_be_used_gets_one_message_and_status_2(tmp_path: Path, what: str) -> None:
    spoil, message = UNUSABLE[what]
    done, result = run(tmp_path, spoil(drift(6.0, twin=True)))
    assert done.returncode == 2 and message in done.stderr and "Traceback" not in done.stderr
    assert result == {}


@pytest.mark.slow
@pytest.mark.parametrize("what", ["constant inputs", "one run of 40 rows", "inputs all missing"])
def test_unexpected_input_never_gives_a_confident_finding(tmp_path: Path, what: str) -> None:
    whole = drift(0.0, twin=True)
    odd = {
        "constant inputs": lambda: constant(constant(constant(whole, "x", 5.0), "dir", 1.0), "rise", 20.0),
        "one run of 40 rows": lambda: whole.take(np.arange(40)),
        "inputs all missing": lambda: constant(constant(whole, "rise", np.nan), "x", np.nan),
    }[what]()
    done, result = run(tmp_path, odd)
    assert done.returncode == 0, done.stderr
    named = [f for f in result["responses"][0]["findings"] if f["effect"] not in ("recalibration", "unknown")]
    assert all(f["confidence"] < 0.5 for f in named)


@pytest.mark.slow
def test_applied_findings_leave_nothing_for_a_pipeline_to_find(tmp_path: Path) -> None:
    """diagnose --apply, then the corrected folder through ingest and diagnose: agreement."""
    from errpipe.pipeline import runner
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES

    done, result = run(tmp_path, drift(6.0, twin=True), "--apply", "better")
    assert done.returncode == 0 and "added to the simulation: backlash" in done.stdout
    assert result["responses"][0]["verdict"] == "missing_physics"
    written = {p.name for p in (tmp_path / "better").iterdir()}
    assert written >= {"recording.yaml", "recording.parquet", "terms.yaml", "patch.py", "patch.fmu", "apply.json"}
    assert "better/patch.py" in done.stdout and "report.html" in done.stdout
    equation = "deviation(d) = -lost_motion / 2 * d"
    assert equation in (tmp_path / "better/patch.py").read_text()
    assert equation in next(tmp_path.glob("*/report.html")).read_text()
    stages = [{"kind": "ingest", "recording": "better"}, {"kind": "diagnose"}]
    (tmp_path / "p.yaml").write_text(json.dumps({"pipeline": 1, "title": "again", "stages": stages}))
    runner.run(load_pipeline(tmp_path / "p.yaml", STAGES), tmp_path / "pipeline")
    again = json.loads((tmp_path / "pipeline/diagnose/diagnosis.json").read_text())
    assert again["responses"][0]["verdict"] == "no_mismatch"


def test_apply_does_not_write_over_the_recording(tmp_path: Path) -> None:
    done, _ = run(tmp_path, drift(6.0, twin=True), "--apply", "in")
    assert done.returncode == 2 and "other than those of the recording" in done.stderr
