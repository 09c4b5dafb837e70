"""A circular test becomes a polar plot with its figures and what a metrologist reads off it."""

from pathlib import Path

import numpy as np

from errpipe import yamlfile
from errpipe.domain.machine import Machine
from errpipe.domain.recording import Recording
from errpipe.kinematics.chain import compile_chain
from errpipe.simulation import metrology
from errpipe.stages.measure import ballbar_pages
from errpipe.validation import iso230_4

MACHINE = Path(__file__).parents[3] / "examples" / "machines" / "vertical-centre.yaml"


def test_squareness_is_read_off_the_circle():
    chain = compile_chain(yamlfile.load(MACHINE, Machine))
    runs = metrology.circles(chain, chain.travel.mean(axis=1), 100.0, 120.0)
    recording = metrology.simulate_runs(chain, {"C0Y": 40.0}, "ballbar_circle", runs, 1, noise=0.2, setup=5.0)
    pages = ballbar_pages(recording)
    assert len(pages) == 3
    _, figure, caption = next(p for p in pages if p[0].endswith("XY"))
    assert "squareness" in caption or "C0Y = " in caption
    assert "+Y leans towards minus X" in caption and "Not significant (95 %): " in caption
    assert "squareness" in figure and figure.startswith("<svg") and "G XY ccw" in figure and "F XY cw" in figure
    assert pages == ballbar_pages(recording)


def test_where_the_bar_stood_is_not_drawn():
    """A socket half a millimetre off the circle's centre: F about the circle's own centre stays small."""
    chain = compile_chain(yamlfile.load(MACHINE, Machine))
    runs = metrology.circles(chain, chain.travel.mean(axis=1), 100.0, 120.0)
    recording = metrology.simulate_runs(chain, {}, "ballbar_circle", runs, 1, noise=0.2, setup=500.0)
    for test in iso230_4.circles(recording):
        assert np.ptp(test.deviation) > 100 and np.ptp(iso230_4.centred(test)) < 6.0


def test_a_servo_mismatch_is_reported():
    """One axis 1 um behind the other: the oval turns with the sense."""
    chain = compile_chain(yamlfile.load(MACHINE, Machine))
    runs = metrology.circles(chain, chain.travel.mean(axis=1), 100.0, 120.0)
    recording = metrology.simulate_runs(chain, {}, "ballbar_circle", runs, 1, noise=0.2, setup=5.0)
    sense = np.where(np.char.endswith(recording.frame["run"].to_numpy(str), " ccw"), 1.0, -1.0)
    angle = np.arctan2(recording.array("y"), recording.array("x"))
    xy = np.char.startswith(recording.frame["run"].to_numpy(str), "XY")
    frame = recording.frame.assign(E_R=recording.array("E_R") + 4.0 * sense * np.sin(2 * angle) * xy)
    pages = ballbar_pages(Recording(recording.manifest, frame))
    assert "X lags the other axis by 7.9" in next(caption for name, _, caption in pages if name.endswith("XY"))
