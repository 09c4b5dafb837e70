"""What the beam does to a record (air, cosine, Abbe, zero) is planted, corrected, and wrong where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from machines import ready
from records_played import ABBE, AIR, COSINE, WAVELENGTH, largest_gap, of_axis, played_x, solve

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.kinematics import air, direct
from errpipe.simulation import direct_records as played
from errpipe.simulation import metrology


@pytest.mark.parametrize(
    ("beam", "wrong_by"),
    [(AIR, 1.0), (COSINE, 4.0), (ABBE, 2.0), (WAVELENGTH, 0.3)],
    ids=["dead path", "cosine", "Abbe", "wavelength"],
)
def test_a_planted_beam_error_is_corrected_and_wrong_where_it_is_not(beam, wrong_by):
    """EXX from 0.05 um readings: right with the correction, wrong by the planted size without.

    Upwards only: what drifts with the weather cancels between up and down, and would pass for reversal.
    """
    chain, values, recording = played_x(beam, cycles=1, warming=8.0)
    recording = recording.take(recording.array("dir_x") > 0)
    right = solve(chain, recording, lasers={"EXX": direct.Laser(**beam)})
    wrong = solve(chain, recording)
    assert largest_gap(chain, values, right) < 0.12
    assert largest_gap(chain, values, wrong) > wrong_by


SENSORS = direct.Laser().air_uncertainty  # of an ordinary weather station


def test_the_band_holds_the_uncertainty_of_the_air():
    """Weather stations off by their own uncertainty: the 95 % band covers; it does not where none is stated (74 %)."""
    p = np.linspace(0, 800, 17)
    covered = {}
    for sensors in (SENSORS, (0.0, 0.0, 0.0)):
        inside = []
        for seed in range(20):
            chain, values, recording = played_x({}, cycles=3)
            t, hpa, percent = np.add(air.STANDARD_AIR, np.random.default_rng(seed).normal(0, SENSORS))
            true = air.refractivity(*air.STANDARD_AIR[:2], air.vapour_pressure(20.0, 50.0))
            wrong = air.refractivity(t, hpa, air.vapour_pressure(t, percent))
            shown = recording.array("EXX") + recording.array("x") * 1e3 * (true - wrong)
            moved = Recording(recording.manifest, recording.frame.assign(EXX=shown))
            solution = solve(chain, moved, lasers={"EXX": direct.Laser(air_uncertainty=sensors)})
            value, error = solution.component("EXX", p)
            inside.append(np.mean(np.abs(value - values["EXX"](p)) <= 1.96 * error))
        covered[sensors] = float(np.mean(inside))
    assert 0.85 <= covered[SENSORS] <= 1.0
    assert covered[0.0, 0.0, 0.0] < 0.8


def test_the_uncertainty_of_the_index_is_that_of_its_sensors():
    """Sensitivities of the index: 0.95e-6/K, 0.27e-6/hPa, 0.0085e-6/%; what was not read is more uncertain."""
    assert air.index_uncertainty((0.1, 0.0, 0.0)) == pytest.approx(0.095, abs=0.001)
    assert air.index_uncertainty((0.0, 1.0, 0.0)) == pytest.approx(0.268, abs=0.001)
    *_, recording = played_x({})
    assert recording.name("humidity") is None
    shown = direct.air_uncertainty(recording, direct.Laser(wavelength_corrected=False))
    assert shown == pytest.approx(air.index_uncertainty((0.1, 0.5, air.UNMEASURED_HUMIDITY)))
    assert direct.air_uncertainty(recording, direct.Laser()) < shown


def test_a_laser_zeroed_in_each_run_has_a_zero_per_run():
    """Runs displaced by 5 um rms: one zero smears them into noise and waves, a zero each leaves the curve."""
    chain, values, recording = played_x({}, cycles=3)
    run = recording.run_codes()
    if np.unique(run).size < 3:  # the simulated test is one run of three cycles
        run = np.arange(len(recording)) * 3 // len(recording)
    shift = np.array([0.0, 7.0, -6.0])[run]
    frame = recording.frame.assign(EXX=recording.array("EXX") + shift)
    frame[recording.name("run")] = run.astype(str)
    moved = Recording(recording.manifest, frame)
    right = solve(chain, moved, lasers={"EXX": direct.Laser(zero_each_run=True)})
    wrong = solve(chain, moved)
    p = np.linspace(0, 800, 41)
    assert largest_gap(chain, values, right) < 0.2
    assert right.component("EXX", p)[1].max() < 0.3 * wrong.component("EXX", p)[1].max()


def test_a_run_that_sits_out_is_judged_without_its_own_zero():
    """Zeros 20 um apart are no error of the curve: the left-out run stands at its noise, and before at the curve."""
    from errpipe.models.direct import validate_fold

    chain, _, recording = played_x({}, cycles=3)
    run = recording.run_codes()
    assert np.unique(run).size == 3
    frame = recording.frame.assign(EXX=recording.array("EXX") + np.array([0.0, 27.0, -16.0])[run])
    moved = Recording(recording.manifest, frame)

    def judged(shown: Recording, zero_each_run: bool) -> tuple[float, float]:
        lasers = {"EXX": direct.Laser(zero_each_run=zero_each_run)}
        (left,) = [x for x in validate_fold(chain, shown, run != 1, run == 1, lasers=lasers) if x.component == "EXX"]
        return float(np.std(left.before)), float(np.sqrt(np.mean(left.after**2)))

    assert judged(moved, True) == pytest.approx(judged(recording, True), rel=0.2)
    assert judged(moved, True)[1] < 0.2
    assert judged(moved, False)[1] > 10.0


def test_a_display_s_air_takes_the_air_of_the_record():
    """A temperature without a stated location is not taken as that of the air, and is reported."""
    chain, _, recording = played_x({}, cycles=1)
    columns = dict(recording.manifest.columns)
    columns["T_air"] = columns["T_air"].model_copy(update={"location": "beside the beam"})
    bare = Recording(recording.manifest.model_copy(update={"columns": columns}), recording.frame)
    lasers = {"EXX": direct.Laser(wavelength_corrected=False, display_air=(20.0, 1013.25, 50.0))}
    assert solve(chain, recording, lasers=lasers)
    with pytest.raises(DataError, match=r"display_air takes .* \(found: p_air;"):
        solve(chain, bare, lasers=lasers)


def test_a_display_fixed_at_another_index_is_corrected_only_if_it_is_stated():
    """Fixed at 20 degC and 1013.25 hPa, read at 28 degC and 960 hPa throughout: -21 um/m of 0.8 m, half either way."""
    chain, values, recording = played_x({}, cycles=1)
    count, fixed = len(recording), (20.0, 1013.25, 50.0)
    warm = {"temperature": np.full(count, 28.0), "pressure": np.full(count, 960.0)}
    shown = recording.array("EXX") + 1e3 * recording.array("x") * air.index_change(**warm, since=fixed)
    recording = recording.with_columns({"EXX": shown, "T_air": warm["temperature"], "p_air": warm["pressure"]}, {})
    said = direct.Laser(wavelength_corrected=False, display_air=fixed)
    unsaid = direct.Laser(wavelength_corrected=False)
    assert largest_gap(chain, values, solve(chain, recording, lasers={"EXX": said})) < 0.2
    assert 6.0 < largest_gap(chain, values, solve(chain, recording, lasers={"EXX": unsaid})) < 18.0


def test_cosine_is_of_the_planted_size():
    """4 mrad over 800 mm reads short by 800 mm x (4e-3)^2 / 2 = 6.4 um at the far end."""
    chain, _, recording = played_x(COSINE, reversal=0.0)
    right, wrong = solve(chain, recording, lasers={"EXX": direct.Laser(**COSINE)}), solve(chain, recording)
    end = np.array([800.0])
    assert wrong.component("EXX", end)[0][0] - right.component("EXX", end)[0][0] == pytest.approx(-6.4, abs=0.05)


def test_an_abbe_offset_whose_angles_were_not_measured_widens_the_interval():
    chain, values, recording = played_x(ABBE)
    lasers = {"EXX": direct.Laser(**ABBE)}
    kept = {n: c for n, c in recording.manifest.columns.items() if n not in ("EAX", "EBX", "ECX")}
    bare = Recording(recording.manifest.model_copy(update={"columns": kept}), recording.frame[list(kept)])
    p = np.linspace(0, 800, 41)
    _, sure = solve(chain, recording, lasers=lasers).component("EXX", p)
    value, unsure = solve(chain, bare, lasers=lasers).component("EXX", p)
    assert unsure.max() > 10 * sure.max()
    assert np.all(np.abs(value - values["EXX"](p)) < 4 * unsure + 0.5)


def test_straightness_with_its_point_reads_the_angles_too():
    beam = {"offset": (0.0, 0.0, 300.0)}
    chain = ready("vertical-centre")
    values = metrology.smooth_machine(chain, 5)
    setup = played.SetUp(noise=0.05, angle_noise=0.1, beams={"EYX": played.Laser(**beam)})
    recording = of_axis(played.record(chain, values, setup, 5), "X")
    right, wrong = solve(chain, recording, lasers={"EYX": direct.Laser(**beam)}), solve(chain, recording)
    assert largest_gap(chain, values, right, "EYX") < 0.12
    assert largest_gap(chain, values, wrong, "EYX") > 0.3
