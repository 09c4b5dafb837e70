"""An FMU over a recording's inputs: right numbers, right units, and no harm when it crashes, hangs or eats memory."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError, UsageError
from errpipe.simulation import external
from errpipe.simulation.fmu_process import FmuProcess

pytestmark = pytest.mark.skipif(importlib.util.find_spec("pythonfmu") is None, reason="pythonfmu builds the FMUs")

MODEL = '''
import ctypes, math, time
from pythonfmu import Fmi2Causality as C, Fmi2Slave, Fmi2Variability as V, Real

class Model(Fmi2Slave):
    """A part that follows a temperature rise late and grows."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.rise, self.gain, self.tau, self.level, self.mode, self.z, self.state = 0.0, 2.0, 600.0, 0.0, 0.0, 0.0, 0.0
        self.register_variable(Real("rise", causality=C.input, start=0.0))
        for name, start in (("gain", 2.0), ("tau", 600.0), ("level", 0.0), ("mode", 0.0)):
            self.register_variable(Real(name, causality=C.parameter, variability=V.tunable, start=start))
        self.register_variable(Real("z", causality=C.output))
        self.register_variable(Real("state", causality=C.local))

    def do_step(self, t, dt):
        print("chatter on standard output")
        if self.mode == 1:
            ctypes.string_at(0)
        if self.mode == 2:
            time.sleep(600)
        if self.mode == 3:
            self.eaten = [bytes(10_000_000) for _ in range(10_000)]
        if self.mode == 4:
            raise ValueError("the matrix is singular")
        self.state += (self.rise - self.state) * (1 - math.exp(-dt / self.tau))
        self.z = math.nan if self.mode == 5 else self.level + self.gain * self.state
        return True
'''


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "model.py").write_text(MODEL)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "model.py", "-d", "."]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "Model.fmu"


def declared(model: Path, folder: Path, **units: str) -> Path:
    """The FMU with units declared for some of its variables."""
    out = folder / "declared.fmu"
    with zipfile.ZipFile(model) as source, zipfile.ZipFile(out, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                text = data.decode()
                for variable, unit in units.items():
                    pattern = rf'(name="{variable}"[^>]*>\s*<Real)'
                    text, count = re.subn(pattern, rf'\1 unit="{unit}"', text)
                    assert count == 1, text
                output = "".join(f'<Unit name="{u}"/>' for u in sorted(set(units.values())))
                output = f"<UnitDefinitions>{output}</UnitDefinitions>"
                text = re.sub("(<LogCategories|<DefaultExperiment|<ModelVariables)", output + r"\1", text, count=1)
                data = text.encode()
            target.writestr(name, data)
    return out


def late(t: np.ndarray, rise: np.ndarray, tau: float) -> np.ndarray:
    """The lag by many small steps, an input drawn straight between rows."""
    fine = np.linspace(t[0], t[-1], 100 * t.size)
    u, y = np.interp(fine, t, rise), np.zeros(100 * t.size)
    share = 1 - np.exp(-(fine[1] - fine[0]) / tau)
    for k in range(1, fine.size):
        y[k] = y[k - 1] + (u[k] - y[k - 1]) * share
    return np.interp(t, fine, y)


def recorded(gain: float = 2.0, tau: float = 600.0, datum: float = 17.0, noise: float = 0.0) -> Recording:
    t = np.arange(0.0, 4000.0, 20.0)
    rise = 2 + 8 * (1 - np.exp(-t / 1500)) + np.sin(t / 400)
    values = datum + gain * late(t, rise, tau) + noise * np.random.default_rng(1).standard_normal(t.size)
    kinds = {
        "t": Column(role="time", unit="s"),
        "T": Column(role="temperature", unit="degC"),
        "feed": Column(role="feed", unit="mm/min"),
        "E_Z": Column(role="error", component="E_Z", unit="um"),
    }
    frame = pd.DataFrame({"t": t, "T": 20 + rise, "feed": np.full(t.size, 1000.0), "E_Z": values})
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), frame)


def asked(**options) -> external.FromFmu:
    rise = {"column": "T", "unit": "K", "rise_from": 20.0}
    usual = {"kind": "fmu", "inputs": {"rise": rise}, "outputs": {"E_Z": {"variable": "z", "unit": "um"}}}
    return external.FromFmu.model_validate(usual | options)


def simulated(recording: Recording, file: Path, **options):
    out, (twin,), figures = external.with_twins(recording, asked(**options), file)
    return out.array(twin.column), twin, figures


def test_it_says_what_its_equations_say(model: Path) -> None:
    recording = recorded(datum=0.0)
    values, twin, figures = simulated(recording, model)
    assert_allclose(values, recording.array("E_Z"), atol=0.1)  # an input is held during a step of 5 s
    assert twin.with_twin == 200 and figures["step_s"] == 5.0 and figures["fmi"] == "2.0"


def test_units_and_sign_of_the_output(model: Path) -> None:
    plain, _, _ = simulated(recorded(), model)
    in_m, _, _ = simulated(recorded(), model, outputs={"E_Z": {"variable": "z", "unit": "m"}})
    turned, _, _ = simulated(recorded(), model, outputs={"E_Z": {"variable": "z", "unit": "um", "means": "correction"}})
    assert_allclose(in_m, 1e6 * plain)
    assert_allclose(turned, -plain)


def test_a_temperature_is_no_rise(model: Path) -> None:
    """In kelvin an absolute temperature counts from -273.15 degC; a rise does not."""
    plain, _, _ = simulated(recorded(), model)
    absolute, _, _ = simulated(recorded(), model, inputs={"rise": {"column": "T", "unit": "K"}})
    celsius, _, _ = simulated(recorded(), model, inputs={"rise": {"column": "T", "unit": "degC"}})
    assert absolute[-1] - plain[-1] == pytest.approx(2 * 293.15, rel=0.01)
    assert celsius[-1] - plain[-1] == pytest.approx(2 * 20, rel=0.01)


def test_a_rise_may_start_with_each_session(model: Path) -> None:
    first, _, _ = simulated(recorded(), model, inputs={"rise": {"column": "T", "unit": "K", "rise_from": "first"}})
    plain, _, _ = simulated(recorded(), model)
    assert first[0] == pytest.approx(0.0, abs=1e-9) and plain[-1] - first[-1] == pytest.approx(2 * 2.0, rel=0.01)


def test_parameters_are_recalibrated_whatever_the_datum(model: Path) -> None:
    tunable = [{"parameter": "gain", "low": 0.5, "high": 10}, {"parameter": "tau", "low": 100, "high": 3000}]
    values, _, figures = simulated(recorded(3.0, 900.0, noise=0.3), model, recalibrate=tunable, step=20.0)
    gain, tau = figures["parameters"]
    assert gain["start"] == 2.0 and gain["value"] == pytest.approx(3.0, abs=0.06) and not gain["at_a_bound"]
    assert tau["value"] == pytest.approx(900.0, rel=0.06)
    left = recorded(3.0, 900.0, noise=0.3).array("E_Z") - values
    assert np.std(left) < 0.4 and np.mean(left) == pytest.approx(17.0, abs=0.3)


def test_a_bound_is_kept_and_reported(model: Path) -> None:
    tunable = [{"parameter": "gain", "low": 0.5, "high": 2.5}]
    _, twin, figures = simulated(recorded(3.0, noise=0.1), model, recalibrate=tunable, step=20.0)
    assert figures["parameters"][0]["value"] <= 2.5 and figures["parameters"][0]["at_a_bound"]
    assert "gain ends at one of its bounds" in twin.notes


def test_a_parameter_that_only_moves_the_datum_stays(model: Path) -> None:
    tunable = [{"parameter": "level", "low": -50, "high": 50}]
    _, twin, figures = simulated(recorded(noise=0.1), model, recalibrate=tunable, step=20.0)
    assert figures["parameters"][0]["value"] == 0.0 and not figures["parameters"][0]["shows"]
    assert any("changes only the datum" in note for note in twin.notes)


def test_sessions_start_anew_and_runs_in_a_row_do_not(model: Path) -> None:
    one = recorded()
    half = np.where(np.arange(200) < 100, "a", "b")
    kinds = one.manifest.model_copy(update={"columns": {"run": Column(role="run"), **one.manifest.columns}})
    together = Recording(kinds, one.frame.assign(run=half))
    apart = Recording(kinds, one.frame.assign(run=half, t=one.time() + np.where(half == "b", 1e5, 0.0)))
    assert_allclose(simulated(together, model)[0], simulated(one, model)[0])
    restarted = simulated(apart, model)[0]
    assert restarted[100] == pytest.approx(0.0, abs=1e-9) and simulated(one, model)[0][100] > 5


@pytest.mark.parametrize(
    "mode, message",
    [
        (1, r"simulating it, its process ended by itself \(SIGSEGV\)"),
        pytest.param(2, r"simulating it took longer than 2 s \(time_limit\); it was ended", marks=pytest.mark.slow),
        (3, r"simulating it"),
        (4, r"simulating it failed.*"),
        (5, r"199 of 200 recorded rows have no simulated value.*not finite"),
    ],
)
def test_what_it_does_to_itself_it_does_alone(model: Path, mode: int, message: str) -> None:
    start = time.perf_counter()
    with pytest.raises(DataError, match=message) as output:
        simulated(recorded(), model, parameters={"mode": mode}, time_limit=2.0 if mode == 2 else 30.0, memory_mb=1024)
    assert time.perf_counter() - start < 90  # it would hang for ever; starting a process takes long on a busy machine
    assert output.value.exit_code == 3 and "/tmp" not in str(output.value) and "Traceback" not in str(output.value)


def test_no_process_outlives_its_recording(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    entered = FmuProcess.__enter__
    monkeypatch.setattr(FmuProcess, "__enter__", lambda self: seen.append(entered(self)) or self)
    with pytest.raises(DataError):
        simulated(recorded(), model, parameters={"mode": 2}, time_limit=2.0)
    assert seen[0].process.returncode is not None and not seen[0].folder.exists()


@pytest.mark.parametrize(
    "options, message",
    [
        ({"inputs": {"rize": {"column": "T"}}}, r"no input 'rize' \(it has: rise\).*Did you mean rise\?"),
        ({"inputs": {"z": {"column": "T"}}}, "z is its output, not an input"),
        ({"inputs": {"rise": {"column": "T_nut", "unit": "K"}}}, "driven by T_nut, which the recording lacks"),
        ({"inputs": {"rise": {"column": "T"}}}, "rise has no declared unit: set it with `unit`"),
        ({"inputs": {"rise": {"column": "feed", "unit": "K"}}}, r"rise \(K\) cannot be given feed \(mm/min\)"),
        ({"inputs": {"rise": {"column": "T", "unit": "quux"}}}, "not a known unit"),
        ({"inputs": {"rise": {"column": "feed", "unit": "K", "rise_from": 1.0}}}, "rise_from is for temperatures"),
        ({"outputs": {"E_Z": {"variable": "y", "unit": "um"}}}, r"no output 'y' \(it has: z"),
        ({"outputs": {"E_Z": {"variable": "z", "unit": "K"}}}, r"E_Z \(um\) cannot be z \(K\)"),
        ({"outputs": {"EXX": {"variable": "z", "unit": "um"}}}, "no response EXX"),
        ({"parameters": {"rise": 1.0}}, "rise is its input, not an parameter|rise is its input"),
        ({"recalibrate": [{"parameter": "gian", "low": 0, "high": 1}]}, "Did you mean gain"),
        ({"step": 1e-5}, "are too many"),
    ],
)
def test_what_does_not_fit_is_reported(model: Path, options: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        simulated(recorded(), model, **options)


def test_declared_units_need_not_be_repeated_and_must_not_be_contradicted(model: Path, tmp_path: Path) -> None:
    file = declared(model, tmp_path, rise="K", z="m")
    plain, _, _ = simulated(recorded(), model)
    bare = {"inputs": {"rise": {"column": "T", "rise_from": 20.0}}, "outputs": {"E_Z": {"variable": "z"}}}
    assert_allclose(simulated(recorded(), file, **bare)[0], 1e6 * plain)
    with pytest.raises(DataError, match="z is declared in m, not in um"):
        simulated(recorded(), file, inputs=bare["inputs"])


def test_an_unconnected_input_keeps_its_start_value_and_is_reported(model: Path) -> None:
    values, twin, _ = simulated(recorded(), model, inputs={})
    assert_allclose(values, 0.0, atol=1e-12)
    assert "input rise keeps its start value 0" in twin.notes[0]


def test_missing_readings_are_interpolated_and_reported(model: Path) -> None:
    recording = recorded()
    holed = recording.with_columns({"T": np.where(np.arange(200) % 10 == 5, np.nan, recording.array("T"))}, {})
    values, twin, _ = simulated(holed, model)
    assert_allclose(values, simulated(recording, model)[0], atol=0.05)
    assert "20 missing readings of T were interpolated" in twin.notes
    empty = recording.with_columns({"T": np.full(200, np.nan)}, {})
    with pytest.raises(DataError, match="T, which drives rise, misses 200 of 200 readings"):
        simulated(empty, model)


def test_by_name_columns_drive_inputs_of_their_name(model: Path) -> None:
    recording = recorded()
    kinds = {
        "rise": recording.manifest.columns["T"],
        "t": recording.manifest.columns["t"],
        "z": recording.manifest.columns["E_Z"],
    }
    frame = recording.frame.rename(columns={"T": "rise", "E_Z": "z"})[["rise", "t", "z"]]
    alike = Recording(recording.manifest.model_copy(update={"columns": kinds}), frame)
    how = external.by_name(alike, model)
    assert how.inputs["rise"].column == "rise" and how.inputs["rise"].unit == "degC"
    assert how.outputs["E_Z"].variable == "z" and how.outputs["E_Z"].unit == "um"
    with pytest.raises(DataError, match=r"none of its outputs \(z\) is a response \(E_Z\)"):
        external.by_name(recording, model)


def test_a_file_that_is_no_fmu(tmp_path: Path, model: Path) -> None:
    (tmp_path / "no.fmu").write_text("no zip")
    with pytest.raises(DataError, match=r"no\.fmu: loading it failed"):
        simulated(recorded(), tmp_path / "no.fmu")
    with pytest.raises(DataError, match="there is no such file"):
        simulated(recorded(), tmp_path / "absent.fmu")


def test_without_fmpy_the_extra_is_named(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pip install 'errpipe\[fmu\]'"):
        simulated(recorded(), model)


def test_without_posix_processes_the_way_out_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows: nothing is started, and no internal error."""
    monkeypatch.delattr(os, "fork")
    with pytest.raises(UsageError, match=r"m\.fmu: an FMU runs on Linux, macOS and in WSL only.*kind: csv"):
        FmuProcess(tmp_path / "m.fmu", tmp_path, None).__enter__()


def test_fmpy_is_not_imported_here() -> None:
    code = "import errpipe.simulation.external, errpipe.stages, sys; print('fmpy' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"


FMI3 = """
#include <math.h>
#include <stdlib.h>
typedef struct { double u, y, gain; } M;
typedef void* I; typedef unsigned int VR; typedef _Bool B; typedef int S;
#define X __attribute__((visibility("default")))
X const char* fmi3GetVersion(void) { return "3.0"; }
X I fmi3InstantiateCoSimulation(const char* n, const char* t, const char* r, B v, B l, B e, B a, const VR q[], size_t k,
  void* env, void* log, void* up) { M* m = calloc(1, sizeof(M)); m->gain = 3; return m; }
X void fmi3FreeInstance(I i) { free(i); }
X S fmi3EnterInitializationMode(I i, B d, double tol, double t0, B s, double t1) { return 0; }
X S fmi3ExitInitializationMode(I i) { return 0; }
X S fmi3Terminate(I i) { return 0; }
X S fmi3Reset(I i) { return 0; }
X S fmi3SetFloat64(I i, const VR r[], size_t n, const double v[], size_t m) {
  for (size_t k = 0; k < n; k++) { if (r[k] == 1) ((M*)i)->u = v[k]; if (r[k] == 3) ((M*)i)->gain = v[k]; } return 0; }
X S fmi3GetFloat64(I i, const VR r[], size_t n, double v[], size_t m) { M* s = i;
  for (size_t k = 0; k < n; k++) v[k] = r[k] == 1 ? s->u : r[k] == 3 ? s->gain : s->gain * s->u; return 0; }
X S fmi3DoStep(I i, double t, double h, B p, B* e, B* term, B* early, double* last) {
  *e = 0; *term = 0; *early = 0; *last = t + h; return 0; }
"""
FMI3_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Gain" instantiationToken="t">
 <CoSimulation modelIdentifier="Gain" canHandleVariableCommunicationStepSize="true"/>
 <UnitDefinitions><Unit name="K"/><Unit name="um"/></UnitDefinitions>
 <ModelVariables>
  <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
  <Float64 name="u" valueReference="1" causality="input" variability="continuous" start="0" unit="K"/>
  <Float64 name="y" valueReference="2" causality="output" variability="continuous" unit="um"/>
  <Float64 name="gain" valueReference="3" causality="parameter" variability="tunable" start="3"/>
 </ModelVariables>
 <ModelStructure><Output valueReference="2"/></ModelStructure>
</fmiModelDescription>
"""


def unused_functions() -> str:
    """The other functions of FMI 3, which FMPy wants to find even where nobody calls them."""
    import fmpy

    named = re.findall(r"\bfmi3[A-Z]\w+", (Path(fmpy.__file__).parent / "fmi3.py").read_text())
    types = re.findall(r"^(fmi3\w+)\s*=", (Path(fmpy.__file__).parent / "fmi3.py").read_text(), re.MULTILINE)
    absent = sorted(set(named) - set(types) - set(re.findall(r"fmi3[A-Z]\w+", FMI3)))
    return "".join(f"X S {name}(void) {{ return 3; }}\n" for name in absent)


@pytest.mark.toolchain
def test_fmi_3_as_well(tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("no C compiler to make an FMI 3 FMU with")
    (tmp_path / "gain.c").write_text(FMI3 + unused_functions())
    command = [compiler, "-shared", "-fPIC", "-w", "-o", "Gain.so", "gain.c", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    import platform

    with zipfile.ZipFile(tmp_path / "Gain.fmu", "w") as target:
        target.writestr("modelDescription.xml", FMI3_XML)
        target.write(tmp_path / "Gain.so", f"binaries/{platform.machine()}-linux/Gain.so")
    how = {
        "inputs": {"u": {"column": "T", "rise_from": 20.0}},
        "outputs": {"E_Z": {"variable": "y"}},
        "parameters": {"gain": 4.0},
    }
    values, _, figures = simulated(recorded(), tmp_path / "Gain.fmu", **how)
    assert figures["fmi"] == "3.0"
    assert_allclose(values, 4 * (recorded().array("T") - 20), atol=0.2)  # the last step's input is held
