"""Input that cannot be used gets one clear message; unexpected input never a confident finding."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.diagnosis import diagnose
from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import DataError

from .machines import axis, spindle


def changed(case: Recording, **columns) -> Recording:
    return Recording(case.manifest, case.frame.assign(**columns))


def test_no_simulated_twin():
    case = spindle()
    kinds = {k: c for k, c in case.manifest.columns.items() if k != "E_Z_sim"}
    manifest = case.manifest.model_copy(update={"columns": kinds})
    with pytest.raises(DataError, match="no pair of responses"):
        diagnose(Recording(manifest, case.frame.drop(columns=["E_Z_sim"])))


def test_units_that_differ():
    case = spindle()
    plain = case.manifest.model_dump(mode="json", exclude_none=True)
    plain["columns"]["E_Z_sim"]["unit"] = "urad"
    with pytest.raises(DataError, match="recorded in um, simulated in urad"):
        diagnose(Recording(Manifest.model_validate(plain), case.frame))


def test_three_rows():
    case = spindle()
    with pytest.raises(DataError, match="only 3 rows"):
        diagnose(case.take(np.arange(3)))


def test_all_missing():
    with pytest.raises(DataError, match="only 0 rows"):
        diagnose(changed(spindle(), E_Z=np.nan))


def test_a_response_that_never_changes():
    with pytest.raises(DataError, match="never changes"):
        diagnose(changed(spindle(), E_Z=1.0))


def test_constant_inputs_name_nothing():
    case = changed(spindle(), rpm=0.0, T_bed=20.0, T_room=20.0, E_Z_sim=0.0)
    response = diagnose(case)[0].responses[0]
    assert all(f.confidence < 0.8 for f in response.findings if f.effect not in ("unknown", "recalibration"))


def test_one_short_run_names_nothing_with_confidence():
    case = axis(1).take(np.arange(40))
    response = diagnose(case)[0].responses[0]
    assert not [f for f in response.findings if f.effect != "recalibration" and f.confidence >= 0.8]


def test_missing_cells_and_repeated_rows_change_nothing():
    case = axis(3, hidden=lambda c: -3.0 * c["dir"])
    frame = case.frame.copy()
    frame.loc[10:14, "T_nut"] = np.nan
    frame.loc[200:206, "EXX"] = np.nan
    frame = frame.iloc[np.sort(np.r_[np.arange(len(frame)), [50, 51, 300]])].reset_index(drop=True)
    assert diagnose(Recording(case.manifest, frame))[0].responses[0].findings[0].effect == "backlash"


@pytest.mark.parametrize(("off", "verdict"), [(0.0, "no_mismatch"), (1e-13, "no_mismatch"), (3.0, "recalibrate")])
def test_a_simulation_that_repeats_the_recording(off, verdict):
    """Nothing at all is left to judge: no division by zero, and no finding."""
    case = spindle()
    case = changed(case, E_Z_sim=case.array("E_Z") - off)
    assert diagnose(case)[0].responses[0].verdict == verdict
