"""A circular test becomes a polar plot with its figures and what a metrologist reads off it."""

from pathlib import Path

from errpipe import yamlfile
from errpipe.domain.machine import Machine
from errpipe.kinematics.chain import compile_chain
from errpipe.simulation import metrology
from errpipe.stages.measure import ballbar_pages

MACHINE = Path(__file__).parents[3] / "examples" / "machines" / "vertical-centre.yaml"


def test_squareness_is_read_off_the_circle():
    chain = compile_chain(yamlfile.load(MACHINE, Machine))
    runs = metrology.circles(chain, chain.travel.mean(axis=1), 100.0, 120.0)
    recording = metrology.record(chain, {"C0Y": 40.0}, "ballbar_circle", runs, 1, noise=0.2, setup=5.0)
    pages = ballbar_pages(recording)
    assert len(pages) == 3
    _, figure, _ = next(p for p in pages if p[0].endswith("XY"))
    assert "squareness" in figure and figure.startswith("<svg") and "G XY ccw" in figure and "F XY cw" in figure
    assert pages == ballbar_pages(recording)
