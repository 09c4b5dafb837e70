"""Findings put into the simulation: a second diagnosis finds nothing; the patch says the same as the recording."""

from __future__ import annotations

import importlib.util
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import TransferFunction, lsim

from errpipe.diagnosis import diagnose
from errpipe.diagnosis.applied import corrected, session_datums
from errpipe.diagnosis.derived import with_motion
from errpipe.drivers.sessions import sessions
from errpipe.fitting.spec import ModelSpec
from errpipe.formats import manifest_folder
from errpipe.stages._apply_findings import apply_findings
from errpipe.yamlfile import load
from tests.unit.diagnosis.machines import axis, bare, mornings, spindle, trace


def late(t: np.ndarray, u: np.ndarray, tau: float) -> np.ndarray:
    """First-order lag of an input that is held between rows."""
    y = np.zeros(t.size)
    for k in range(1, t.size):
        y[k] = u[k - 1] + (y[k - 1] - u[k - 1]) * np.exp(-(t[k] - t[k - 1]) / tau)
    return y


def shaken(late: float = 0.0, hertz: float = 0.0):
    """A drive force of the trace at 200 Hz under random pushes: late, or with 40 kg that ring."""
    made, rng = trace(5), np.random.default_rng(5)
    t = made.time()
    push = np.repeat(rng.normal(0, 900, 160), 25)
    known = 0.08 * push
    seen = np.interp(t - late, t, known)
    if hertz:
        mode = TransferFunction([(2 * np.pi * hertz) ** 2], [1, 0.3 * 2 * np.pi * hertz / 5, (2 * np.pi * hertz) ** 2])
        seen = seen + 0.04 * lsim(mode, push - push[0], t)[1] + 0.04 * push[0]
    columns = {"a": push, "F_X": seen + 2 * rng.standard_normal(t.size), "F_X_sim": known}
    frame = made.frame.assign(**columns).drop(columns=["v", "x"])
    kinds = {n: c for n, c in made.manifest.columns.items() if n in frame}
    return replace(made, manifest=made.manifest.model_copy(update={"columns": kinds}), frame=frame)


CASES = {
    "lost motion and a warm screw": lambda: axis(4, hidden=lambda c: -4 * c["dir"] + 9e-3 * c["x"] * (c["T_nut"] - 20)),
    "a wave": lambda: axis(3, hidden=lambda c: 2.5 * np.sin(2 * np.pi * c["x"] / 10)),
    "a late spindle": lambda: spindle(1, hidden=lambda c: 8 * late(c["t"], c["rpm"] / 12000, 900.0)),
    "friction, no term of a controller": lambda: trace(1, hidden=lambda c: 30 * np.sign(c["v"])),
    "friction of an axis whose places alone are known": lambda: bare(trace(1, hidden=lambda c: 30 * np.sign(c["v"]))),
    "a force that comes late": lambda: shaken(late=0.015),
    "a machine that rings": lambda: shaken(hertz=9.0),
    "a gain beside lost motion": lambda: axis(6, gains=(1.2, 1.0), hidden=lambda c: -4 * c["dir"]),
    "two gains alone": lambda: mornings(1, hidden=lambda c: 1.5 * (c["T_bearing"] - 20)),
}


def module(path: Path):
    spec = importlib.util.spec_from_file_location("patch", path)
    outcome = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(outcome)
    return outcome


SLOW = (
    *("friction, no term of a controller", "friction of an axis whose places alone are known"),
    *("a force that comes late", "a machine that rings", "a wave", "two gains alone"),
)
PARAMS = [pytest.param(c, id=c.replace(" ", "-"), marks=[pytest.mark.slow] if c in SLOW else []) for c in CASES]


@pytest.fixture(scope="module", params=PARAMS)
def done(request, tmp_path_factory):
    recording = CASES[request.param]()
    diagnosis, rows = diagnose(recording)
    out = tmp_path_factory.mktemp("corrected")
    document = apply_findings(recording, diagnosis, out, [r.simulated_parts for r in rows])
    return recording, document, out


def test_a_second_diagnosis_finds_nothing(done) -> None:
    _, document, _ = done
    (again,) = document["second_diagnosis"].values()
    assert again["verdict"] == "no_mismatch", again["says"]
    (response,) = document["responses"]
    assert response["put_in"] and response["rms_after_um"] < 0.4 * response["rms_before_um"]
    assert not any(p["not_in_patch"] for p in response["put_in"])


def test_the_python_patch_says_the_same_as_the_corrected_recording(done) -> None:
    recording, document, out = done
    (response,) = document["responses"]
    component, twin = response["component"], response["simulated"]
    patch = module(out / "patch.py")
    read = with_motion(recording)[0]
    columns = {name: read.frame[name].to_numpy() for name in read.frame}
    got = patch.corrected({component: recording.array(twin)}, columns, recording.time(), sessions(recording))[component]
    whole = manifest_folder.read(out)
    assert_allclose(got, whole.array(twin), atol=1e-3 * np.std(whole.array(twin) - recording.array(twin)))
    assert "errpipe" not in (out / "patch.py").read_text()


def test_the_terms_are_those_of_a_fit_stage(done) -> None:
    _, document, out = done
    spec = load(out / "terms.yaml", ModelSpec)
    (response,) = document["responses"]
    assert sum(len(p["terms"]) for p in response["put_in"]) == len(spec.components[0].terms)
    assert not any(t.free() for t in spec.components[0].terms)  # every parameter is stated


@pytest.mark.slow
@pytest.mark.toolchain
@pytest.mark.skipif(shutil.which("cc") is None or not importlib.util.find_spec("fmpy"), reason="needs cc and FMPy")
def test_the_fmu_says_the_same_as_the_python_patch(tmp_path: Path) -> None:
    """Read back by FMPy over the recording's own inputs; a co-simulation's output is one step behind its input."""
    from errpipe.simulation import external

    recording = trace(3, hidden=lambda c: 30 * np.sign(c["v"]) + 12 * np.sin(2 * np.pi * c["x"] / 24))
    diagnosis, rows = diagnose(recording)
    document = apply_findings(recording, diagnosis, tmp_path, [r.simulated_parts for r in rows])
    assert document["fmu"] == "patch.fmu"
    bare = recording.take(np.arange(len(recording)) < 1500)
    how = external.by_name(bare, tmp_path / "patch.fmu")
    both, (twin,), _ = external.with_twins(bare, how, tmp_path / "patch.fmu")
    columns = {name: bare.frame[name].to_numpy() for name in bare.frame}
    wanted = module(tmp_path / "patch.py").deviation(columns, bare.time())["F_X"]
    off = both.array(twin.column) - wanted
    assert np.sqrt(np.mean(off**2)) < 0.02 * np.std(wanted)
    assert np.std(wanted) > 20.0


def test_what_is_not_sure_or_has_no_equation_is_not_put_in() -> None:
    recording = axis(1, hidden=lambda c: -4.0 * c["dir"])
    diagnosis, _ = diagnose(recording)
    (response,) = diagnosis.responses
    unsure = response.findings[0].model_copy(update={"confidence": 0.5, "confidence_of_class": None})
    nameless = response.findings[0].model_copy(update={"effect": "unknown", "term": None})
    partial = diagnosis.model_copy(
        update={"responses": (response.model_copy(update={"findings": (unsure, nameless)}),)}
    )
    (done,) = corrected(recording, partial, 0.8)
    assert not done.parts and len(done.refused) == 2
    assert_allclose(done.simulated, recording.array("EXX_sim"), rtol=0, atol=0)


def test_the_corrected_simulation_knows_nothing_of_what_comes() -> None:
    """The same rows get the same correction, whatever follows them."""
    recording = axis(4, hidden=lambda c: 9e-3 * c["x"] * (c["T_nut"] - 20))
    diagnosis, rows = diagnose(recording)
    (whole,) = corrected(recording, diagnosis, 0.8, [r.simulated_parts for r in rows])
    part = whole.parts[0]
    first = np.arange(len(recording)) < 200
    (term,), (values,) = part.terms, part.values
    assert_allclose(term.value(recording.take(first), values), part.contribution[first], rtol=1e-9)


def test_a_datum_for_each_session_only_where_it_explains_more() -> None:
    rng = np.random.default_rng(0)
    session, y = np.repeat(np.arange(8), 60), rng.normal(0, 1, 480)
    none = np.zeros((480, 0))
    assert session_datums(none, y, session).shape[1] == 1
    assert session_datums(none, y + 3.0 * rng.normal(0, 1, 8)[session], session).shape[1] == 8


@pytest.mark.slow
def test_equal_findings_give_equal_bytes(tmp_path: Path) -> None:
    recording = spindle(2, hidden=lambda c: 5.0 * late(c["t"], c["T_room"] - 20, 3600.0))
    diagnosis, rows = diagnose(recording)
    for name in "ab":
        apply_findings(recording, diagnosis, tmp_path / name, [r.simulated_parts for r in rows])
    for file in ("patch.py", "patch.fmu", "terms.yaml", "recording.parquet", "apply.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    assert json.loads((tmp_path / "a/apply.json").read_text())["apply"] == 1
