import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.errors import DataError, NotIdentifiable
from errpipe.fitting.chunked import fit_chunks
from errpipe.fitting.model import ModelSpec, fit
from tests.unit.fitting.axis_recordings import axis_recording, with_response


@pytest.fixture(scope="module")
def warm_axis():
    recording = axis_recording(runs=12)
    x, rise = recording.array("x"), recording.array("T_nut") - 20.0
    y = 4.0 + 0.01 * x + 11.5e-3 * x * rise - 3.0 * recording.array("dir")
    return with_response(recording, y, 0.4)


def by_runs(recording, count):
    def chunks():
        for code in range(0, len(recording.run_labels()), count):
            run = recording.run_codes()
            yield recording.take((run >= code) & (run < code + count))

    return chunks


def spec(*terms, **more):
    return ModelSpec.model_validate({"components": [{"component": "EXX", "terms": list(terms)}], **more})


TERMS = (
    {"term": "offset"},
    {"term": "chebyshev", "axis": "X", "degree": 4},
    {"term": "scale_expansion", "axis": "X", "sensor": "T_nut"},
    {"term": "backlash", "axis": "X"},
)


@pytest.mark.parametrize("count", [1, 5, 12])
def test_equals_the_fit_in_memory(warm_axis, count):
    whole = fit(warm_axis, spec(*TERMS), calibrate=False)
    parts = fit_chunks(by_runs(warm_axis, count), spec(*TERMS))
    for one, two in zip(whole.components[0].terms, parts.components[0].terms, strict=True):
        assert one.term == two.term
        for p, q in zip(one.parameters, two.parameters, strict=True):
            assert q.value == pytest.approx(p.value, rel=1e-8, abs=1e-10)
            assert q.standard_error == pytest.approx(p.standard_error, rel=0.05)
    assert parts.components[0].rms_after == pytest.approx(whole.components[0].rms_after)
    assert parts.validity == whole.validity


def test_a_datum_per_run_works_over_chunks(warm_axis):
    level = np.linspace(-50, 50, 12)[warm_axis.run_codes()]
    shifted = with_response(warm_axis, warm_axis.array("E") + level)
    found = fit_chunks(by_runs(shifted, 4), spec(*TERMS[1:], nuisance=[{"term": "run_offset"}]))
    assert found.components[0].terms[1].parameters[0].value == pytest.approx(11.5, abs=0.3)
    levels = [p.value for p in found.components[0].nuisance[0].parameters]
    assert_allclose(np.diff(levels), 100 / 11, atol=0.5)


def test_what_needs_all_rows_is_refused(warm_axis):
    late = {"term": "thermal_lag", "sensor": "T_nut"}
    with pytest.raises(DataError, match="thermal_lag has to search tau; fix it"):
        fit_chunks(by_runs(warm_axis, 3), spec(late))
    with pytest.raises(DataError, match="smooth_curve needs all rows at once"):
        fit_chunks(by_runs(warm_axis, 3), spec({"term": "smooth_curve", "axis": "X"}))
    with pytest.raises(DataError, match="only method linear"):
        fit_chunks(by_runs(warm_axis, 3), spec(*TERMS, method="robust"))
    with pytest.raises(DataError, match="no rows"):
        fit_chunks(lambda: [], spec(*TERMS))


def test_twins_are_refused_over_chunks_too(warm_axis):
    with pytest.raises(NotIdentifiable):
        fit_chunks(by_runs(warm_axis, 3), spec(*TERMS, {"term": "scale_error", "axis": "X"}))
