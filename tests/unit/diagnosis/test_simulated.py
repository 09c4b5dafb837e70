"""Three sources of simulated values: CSV, error model, FMU; none of them can take the diagnosis down."""

from __future__ import annotations

import importlib.util

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.diagnosis import diagnose, simulated
from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedParameter, FittedTerm
from errpipe.domain.recording import Recording
from errpipe.errors import DataError

from .machines import spindle


def bare(case: Recording) -> Recording:
    kinds = {k: c for k, c in case.manifest.columns.items() if c.role != "simulated"}
    manifest = case.manifest.model_copy(update={"columns": kinds})
    return Recording(manifest, case.frame.drop(columns=["E_Z_sim"]))


def test_csv_is_aligned_by_time(tmp_path):
    case = spindle()
    coarse = pd.DataFrame({"t": case.time()[::2] + 0.0, "E_Z": case.array("E_Z_sim")[::2]})
    coarse.to_csv(tmp_path / "sim.csv", index=False)
    read = simulated.from_csv(bare(case), tmp_path / "sim.csv")
    assert_allclose(read.array("E_Z_sim")[:-1], case.array("E_Z_sim")[:-1], atol=2e-3)
    assert np.isnan(read.array("E_Z_sim")[-1])  # beyond the simulation's last row nothing is claimed


def test_csv_without_time_is_refused(tmp_path):
    (tmp_path / "sim.csv").write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match="needs a time column"):
        simulated.from_csv(bare(spindle()), tmp_path / "sim.csv")


def test_own_model_as_the_simulation():
    case = spindle(1, hidden=lambda c: -4.0 * (c["rpm"] / 12000) ** 2)
    term = FittedTerm(
        term={"term": "thermal_drift", "sensor": "T_bed"},
        parameters=(FittedParameter(name="gain", value=3.0, unit="um/K"),),
    )
    model = ErrorModel(components=(ComponentModel(component="E_Z", terms=(term,)),))
    read = simulated.from_model(bare(case), model)
    assert_allclose(read.array("E_Z_sim"), case.array("E_Z_sim"), atol=1e-9)
    assert diagnose(read)[0].responses[0].findings[0].effect == "centrifugal_growth"


needs_fmu = pytest.mark.skipif(
    importlib.util.find_spec("fmpy") is None or importlib.util.find_spec("pythonfmu") is None,
    reason="FMPy and pythonfmu are not installed",
)

SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Bed(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.T_bed = 20.0
        self.gain = 2.0
        self.E_Z = 0.0
        self.register_variable(Real("T_bed", causality=Fmi2Causality.input))
        self.register_variable(Real("gain", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("E_Z", causality=Fmi2Causality.output))

    def do_step(self, now, step):
        BODY
        self.E_Z = self.gain * (self.T_bed - 20.0)
        return True
"""


def build(folder, body="pass"):
    from pythonfmu import FmuBuilder

    script = folder / "bed.py"
    script.write_text(SLAVE.replace("BODY", body))
    return FmuBuilder.build_FMU(script, dest=folder)


@needs_fmu
@pytest.mark.slow
def test_fmu_with_another_gain_is_a_recalibration_not_missing_physics(tmp_path):
    read, moved = simulated.from_fmu(bare(spindle(2)), build(tmp_path))
    assert moved == ("gain",)
    assert_allclose(read.array("E_Z_sim")[50:] * 1.5, spindle(2).array("E_Z_sim")[50:], atol=0.2)
    assert diagnose(read)[0].responses[0].verdict == "recalibrate"


@needs_fmu
@pytest.mark.slow
@pytest.mark.parametrize("body", ["raise ValueError('no')", "import os; os._exit(3)", "import time; time.sleep(60)"])
def test_an_fmu_that_fails_crashes_or_hangs_is_a_message(tmp_path, body):
    with pytest.raises(DataError, match=r"failed|stopped"):
        simulated.from_fmu(bare(spindle()), build(tmp_path, body), time_limit=15.0)
