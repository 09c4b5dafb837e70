"""Circular tests: figures on circles whose answer is known, and the reading of every effect with its sign."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import DataError
from errpipe.validation import iso230_4

RADIUS, FEED = 150.0, 1200.0


def test_recording(plane="XY", noise=0.0, seed=0, count=360, **effects) -> Recording:
    """Both senses of one circle with effects in the words of the module: um, urad, um/m, ms."""
    return _recording(plane, noise, seed, count, **effects)


test_recording.__test__ = False


def _recording(
    plane, noise, seed, count, squareness=0.0, scale=0.0, backlash=(0.0, 0.0), servo=0.0, centre=(0.0, 0.0), r0=0.0
):
    rng = np.random.default_rng(seed)
    frames = []
    for sense in (1, -1):
        angle = sense * (np.arange(count) + 0.5) * 2 * np.pi / count
        x, y = RADIUS * np.cos(angle), RADIUS * np.sin(angle)
        vx, vy = -sense * np.sin(angle), sense * np.cos(angle)
        dx = -squareness * 1e-3 * y + scale * 1e-3 * x - backlash[0] / 2 * np.sign(vx) - servo * vx * FEED / 60
        dy = -backlash[1] / 2 * np.sign(vy)
        shift = rng.normal(0, 1, 2) if noise else np.zeros(2)
        e = (dx + centre[0] + shift[0]) * np.cos(angle) + (dy + centre[1] + shift[1]) * np.sin(angle) + r0
        label = "ccw" if sense > 0 else "cw"
        frames.append(
            pd.DataFrame({"run": label, "a": x, "b": y, "feed": FEED, "E_R": e + rng.normal(0, noise, count)})
        )
    manifest = Manifest.model_validate(
        {
            "recording": 1,
            "tables": ["t.csv"],
            "columns": {
                "run": {"role": "run"},
                "a": {"role": "position", "axis": plane[0], "unit": "mm"},
                "b": {"role": "position", "axis": plane[1], "unit": "mm"},
                "feed": {"role": "feed", "unit": "mm/min"},
                "E_R": {"role": "error", "component": "E_R", "unit": "um"},
            },
        }
    )
    return Recording(manifest, pd.concat(frames, ignore_index=True))


def effects(recording) -> dict[tuple[str, str], iso230_4.Effect]:
    (test,) = iso230_4.evaluate(recording)
    return {(e.effect, e.where): e for e in test.effects}


def test_a_perfect_circle_off_centre_has_no_circular_deviation():
    (test,) = iso230_4.evaluate(test_recording(centre=(30.0, -20.0), r0=5.0))
    assert max(test.figures.circular.values()) < 0.01
    assert test.figures.hysteresis < 0.01
    high, low = test.figures.radial["ccw"]
    assert_allclose([high, low], [5 + np.hypot(30, 20), 5 - np.hypot(30, 20)], atol=0.01)


def test_an_oval_has_the_ring_of_its_half_axes():
    (test,) = iso230_4.evaluate(test_recording(squareness=40.0))
    # dr = -S R/2 sin 2 theta: ring from -3 to +3 um
    assert_allclose(list(test.figures.circular.values()), 6.0, atol=0.01)
    assert_allclose(test.figures.both, 6.0, atol=0.01)
    assert test.figures.hysteresis < 1e-6


def test_backlash_is_hysteresis():
    (test,) = iso230_4.evaluate(test_recording(backlash=(8.0, 0.0)))
    assert_allclose(test.figures.hysteresis, 8.0, atol=0.15)


@pytest.mark.parametrize(
    ("given", "key", "value", "unit"),
    [
        ({"squareness": 25.0}, ("squareness", "C0Y"), 25.0, "urad"),
        ({"squareness": -25.0}, ("squareness", "C0Y"), -25.0, "urad"),
        ({"plane": "XZ", "squareness": 25.0}, ("squareness", "B0Z"), -25.0, "urad"),
        ({"plane": "YZ", "squareness": 25.0}, ("squareness", "A0Z"), 25.0, "urad"),
        ({"scale": 30.0}, ("scale_error", "X-Y"), 30.0, "um/m"),
        ({"backlash": (6.0, 0.0)}, ("backlash", "X"), 6.0, "um"),
        ({"backlash": (0.0, 9.0)}, ("backlash", "Y"), 9.0, "um"),
        ({"servo": 0.4}, ("servo_mismatch", "XY"), 0.4, "ms"),
    ],
)
def test_each_effect_is_read_with_its_sign_and_nothing_else(given, key, value, unit):
    names = effects(test_recording(**given))
    assert_allclose(names[key].value, value, rtol=1e-6)
    assert names[key].unit == unit
    assert next(iter(names)) == key  # the largest comes first
    assert all(e.peak_to_peak < 1e-6 for k, e in names.items() if k != key)


def test_squareness_and_servo_mismatch_are_distinguished_by_the_direction():
    names = effects(test_recording(squareness=20.0, servo=0.3, noise=0.2))
    assert_allclose(names["squareness", "C0Y"].value, 20.0, atol=0.5)
    assert_allclose(names["servo_mismatch", "XY"].value, 0.3, atol=0.01)
    assert "leans towards minus X" in names["squareness", "C0Y"].says


def test_intervals_cover():
    inside = []
    for seed in range(120):
        recording = test_recording(squareness=15.0, backlash=(4.0, 2.0), noise=0.5, seed=seed, count=120)
        by_name = {(e.effect, e.where): e for e in iso230_4.read(list(iso230_4.circles(recording)))[0]}
        for key, value in ((("squareness", "C0Y"), 15.0), (("backlash", "X"), 4.0), (("backlash", "Y"), 2.0)):
            low, high = by_name[key].ci95
            inside.append(low < value < high)
    assert 0.92 <= np.mean(inside) <= 0.985


def test_one_axis_is_no_circle():
    recording = test_recording()
    line = Recording(recording.manifest, recording.frame.assign(b=0.0))
    with pytest.raises(DataError, match="moves two axes"):
        iso230_4.evaluate(line)


def test_a_simulated_machine_is_read_with_the_signs_of_its_components():
    """Circles on a machine with full transforms: squareness and scale come out under their ISO names and signs."""
    from pathlib import Path

    from errpipe import yamlfile
    from errpipe.domain.machine import Machine
    from errpipe.kinematics.chain import compile_chain
    from errpipe.simulation import metrology

    path = Path(__file__).parents[3] / "examples" / "machines" / "cmm.yaml"
    chain = compile_chain(yamlfile.load(path, Machine))
    values = {"C0Y": 20.0, "B0Z": -15.0, "A0Z": 10.0, "EXX": lambda p: 0.03 * np.asarray(p)}
    runs = metrology.circles(chain, chain.travel.mean(axis=1), 200.0, 100.0, 180)
    recording = metrology.simulate_runs(chain, values, "ballbar_circle", runs, 1, noise=0.1)
    by_name = {(e.effect, e.where): e.value for t in iso230_4.evaluate(recording) for e in t.effects}
    for name in ("C0Y", "B0Z", "A0Z"):
        assert_allclose(by_name["squareness", name], values[name], atol=0.5)
    assert_allclose(by_name["scale_error", "X-Y"], 30.0, atol=0.5)
    assert_allclose(by_name["scale_error", "Y-Z"], 0.0, atol=0.5)
