"""A ball bar's table over the angle, with radius and plane above it, is a recording of protocol `ballbar_circle`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.domain.protocols import missing_readings, protocol_of
from errpipe.errors import DataError
from errpipe.validation import iso230_4
from tests.unit.importing.known_test import imported, prepared

HEAD = ("Ballbar test", "Radius;150;mm", "Plane;XY", "Feed;1200;mm/min")
PLACES = np.radians(np.arange(0.0, 360.0, 5.0))


def deviation(angle: np.ndarray, sense: int) -> np.ndarray:
    """The bar in um: axes out of square by 20 urad, 3 um that turn with the way round, a radius 2 um too long."""
    return np.round(1.5 * np.sin(2 * angle) + 3.0 * sense * np.cos(3 * angle) + 2.0, 2)


def beside(headers: str, offset: float = 0.0, factor: float = 1.0) -> list[str]:
    """Both ways in columns beside the angle; offset in the unit of the readings, factor: that unit per um."""
    both = zip(np.degrees(PLACES), deviation(PLACES, 1), deviation(PLACES, -1), strict=True)
    return [headers, *(f"{a:g};{offset + factor * up:.5f};{offset + factor * down:.5f}" for a, up, down in both)]


def below(order: int) -> list[str]:
    rows = [f"CCW;{np.degrees(a):g};{d}" for a, d in zip(PLACES, deviation(PLACES, 1), strict=True)]
    back = [f"CW;{np.degrees(a):g};{d}" for a, d in zip(PLACES, deviation(PLACES, -1), strict=True)]
    return ["Direction;Angle [deg];Deviation [um]", *rows, *back[::order]]


def written(tmp_path: Path, lines: list[str], head: tuple[str, ...] = HEAD) -> Path:
    (tmp_path / "f.csv").write_text("\n".join([*head, *lines]), "utf-8")
    return tmp_path / "f.csv"


@pytest.mark.parametrize(
    "lines",
    [
        beside("Angle [deg];CCW [um];CW [um]"),
        beside("Winkel [°];Radius gegen UZS [mm];Radius im Uhrzeigersinn [mm]", 150.0, 1e-3),
        beside("Angle [deg];Correction G3 [um];Correction G2 [um]", factor=-1.0),
        below(-1),
    ],
    ids=["beside", "lengths", "corrections", "below"],
)
def test_a_ball_bar(tmp_path: Path, lines: list[str]) -> None:
    """It was asked to be written by hand."""
    recording = imported(tmp_path, written(tmp_path, lines))
    assert protocol_of(recording) == "ballbar_circle" and missing_readings(recording) is None
    circles = iso230_4.circles(recording)
    assert [(c.label, c.plane, c.sense) for c in circles] == [("XY ccw", ("X", "Y"), 1), ("XY cw", ("X", "Y"), -1)]
    for c in circles:
        assert c.radius == pytest.approx(150)
        assert c.deviation == pytest.approx(deviation(c.angle, c.sense), abs=0.02)
        assert c.speed == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("header", "sign"), [("Radius error CCW [um]", 1.0), ("Correction CCW [um]", -1.0)], ids=["deviation", "correction"]
)
def test_a_machine_too_long_at_plus_x_lengthens_the_bar_there(tmp_path: Path, header: str, sign: float) -> None:
    """10 um at X = +150 mm, growing from the centre: the bar is longer there by 10 um, and unchanged at Y = 150 mm."""
    read = sign * 10.0 * np.cos(PLACES) ** 2
    lines = [f"{angle:g};{value:.4f}" for angle, value in zip(np.degrees(PLACES), read, strict=True)]
    recording = imported(tmp_path, written(tmp_path, [f"Angle [deg];{header}", *lines]))
    x, y, bar = (recording.array(name) for name in ("X", "Y", "E_R"))
    assert bar[np.argmax(x)] == pytest.approx(10.0) and bar[np.argmax(y)] == pytest.approx(0.0, abs=1e-3)


def test_a_plane_begins_with_its_first_axis(tmp_path: Path) -> None:
    head = ("Ballbar", "Radius: 100 mm", "G18")
    recording = imported(tmp_path, written(tmp_path, beside("Angle [deg];CCW [um];CW [um]"), head))
    first, last = recording.array("Z"), recording.array("X")
    assert (first[0], last[0], recording.array("E_R")[0]) == (100.0, 0.0, 5.0)


@pytest.mark.parametrize(
    ("lines", "head", "match"),
    [
        (beside("Angle [deg];CCW [um];CW [um]"), ("Ballbar", "Plane: XY"), "states the radius"),
        (beside("Angle [deg];CCW [um];CW [um]"), ("Ballbar", "Radius: 100 mm"), "states the plane"),
        (beside("Angle [deg];Dev 1 [um];Dev 2 [um]"), HEAD, "'Dev 1': clockwise or counterclockwise"),
        (below(1), HEAD, "rows labelled cw have angles that increase"),
    ],
)
def test_what_a_ball_bar_does_not_state_is_asked(
    tmp_path: Path, lines: list[str], head: tuple[str, ...], match: str
) -> None:
    with pytest.raises(DataError, match=match):
        prepared([written(tmp_path, lines, head)])


THREE_AXES = """machine: 1
name: three-axes
chain: [workpiece, "X'", bed, Y, Z, spindle, tool]
axes:
  X: {kind: linear, travel: [-200, 200]}
  Y: {kind: linear, travel: [-200, 200]}
  Z: {kind: linear, travel: [-300, 0]}
"""
IDENTIFIED = """pipeline: 1
stages:
  - {kind: ingest, recording: rec}
  - {kind: identify, machine: machine.yaml}
  - {kind: validate}
  - {kind: export_volumetric, targets: [linuxcnc_screw], ungated: true}
"""


@pytest.mark.parametrize(("reading", "sign"), [("Radius error", 1.0), ("Correction", -1.0)])
def test_a_ball_bar_through_identify_to_the_controller(tmp_path: Path, reading: str, sign: float) -> None:
    """10 um too long at X = +150 mm against Y: one bar shows no more. The control goes that much less far along X."""
    noise = np.random.default_rng(1).normal(0, 0.1, (PLACES.size, 2))
    read = sign * 10.0 * np.cos(PLACES)[:, None] ** 2 + noise
    lines = [f"{a:g};{up:.3f};{down:.3f}" for a, (up, down) in zip(np.degrees(PLACES), read, strict=True)]
    written(tmp_path, [f"Angle [deg];{reading} CCW [um];{reading} CW [um]", *lines])
    for name, text in (("machine.yaml", THREE_AXES), ("p.yaml", IDENTIFIED)):
        (tmp_path / name).write_text(text, "utf-8")
    assert main(["import", str(tmp_path / "f.csv"), "--out", str(tmp_path / "rec"), "--yes"]) == 0
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 0
    folder = tmp_path / "out" / "export_volumetric"
    x, y = (np.loadtxt(folder / "linuxcnc_screw" / f"{axis}.comp") for axis in "xy")  # nominal, forward, reverse in mm
    along, across = ((c[-1, 1] - c[0, 1]) / (c[-1, 0] - c[0, 0]) for c in (x, y))
    assert 150 * (along - across) == pytest.approx(-0.010, abs=4e-4)
    assert main(["verify", str(folder)]) == 0
