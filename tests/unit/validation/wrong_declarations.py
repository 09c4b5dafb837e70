"""Recordings that are declared wrongly, each as it is read, with the refusal that must name the fault.

`docs/wrong-declarations.md` is the same list for people; a test holds the two together. Long, because it is one list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Constant, Manifest, Recording

TRAVEL = (0.0, 800.0)
INCH = 25.4


def axis_test(seed: int = 1, *, travel: tuple[float, float] = TRAVEL, warm: bool = True) -> Recording:
    """Five bidirectional runs of an X axis at rising temperature: lead error, pitch shape, lost motion, expansion."""
    rng = np.random.default_rng(seed)
    targets = np.linspace(*travel, 21)
    rows: list[dict[str, Any]] = []
    for run in range(5):
        for side, order in ((1.0, targets), (-1.0, targets[::-1])):
            for x in order:
                nut = 20.0 + (1.5 * run if warm else 0.0) + 0.02 * rng.normal()
                rows.append({"run": f"run-{run + 1}", "dir": side, "x": x, "T_nut": nut, "T_air": 20.0 + 0.1 * run})
    frame = pd.DataFrame(rows)
    u = (frame.x - travel[0]) / (travel[1] - travel[0])
    frame["EXX"] = 14e-3 * frame.x + 7 * np.sin(9 * u) + 4 * np.sin(23 * u + 0.5) - 3 * frame["dir"]
    frame["EXX"] += 11.5e-3 * frame.x * (frame.T_nut - 20) + 0.6 * rng.normal(size=len(frame))
    frame["t"] = 12.0 * np.arange(len(frame))
    frame["y"] = 100.0 + 0.0 * frame.x
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="command", axis="X", unit="mm"),
        "y": Column(role="command", axis="Y", unit="mm"),
        "dir": Column(role="direction", axis="X"),
        "T_nut": Column(role="temperature", unit="degC"),
        "T_air": Column(role="temperature", unit="degC"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    constants = {"X": Constant(role="axis", kind="linear", travel=travel, unit="mm")}
    return Recording(Manifest(recording=1, tables=("t.csv",), constants=constants, columns=columns), frame)


def rotary_test() -> Recording:
    """A rotary table C against a polygon: ECC in urad over 0 to 360 degrees."""
    recording = axis_test(2, travel=(0.0, 360.0), warm=False)
    columns = dict(recording.manifest.columns)
    columns["x"] = Column(role="command", axis="C", unit="deg")
    columns["dir"] = Column(role="direction", axis="C")
    columns["EXX"] = Column(role="error", component="ECC", unit="urad")
    manifest = recording.manifest.model_copy(update={"columns": columns, "constants": {}})
    return Recording(manifest, recording.frame)


def put(recording: Recording, **values: Any) -> Recording:
    """The recording with columns replaced."""
    return Recording(recording.manifest, recording.frame.assign(**values))


def declare(recording: Recording, kinds: Mapping[str, Column]) -> Recording:
    """The recording with columns declared otherwise."""
    manifest = recording.manifest.model_copy(update={"columns": {**recording.manifest.columns, **kinds}})
    return Recording(manifest, recording.frame)


def with_actual(recording: Recording, sign: float = 1.0, scale: float = 1.0) -> Recording:
    """The recording with the actual position beside the command, and the error as sign * scale * (actual - command)."""
    f = recording.frame
    read = put(recording, actual=f.x + f.EXX / 1000, EXX=sign * scale * f.EXX)
    return declare(read, {"actual": Column(role="position", axis="X", unit="mm")})


def _error(change: Callable[[pd.DataFrame], Any]) -> Callable[[], Recording]:
    def made() -> Recording:
        recording = axis_test()
        return put(recording, EXX=change(recording.frame))

    return made


def _column(name: str, change: Callable[[pd.DataFrame], Any]) -> Callable[[], Recording]:
    def made() -> Recording:
        recording = axis_test()
        return put(recording, **{name: change(recording.frame)})

    return made


def _reading(change: Callable[[pd.DataFrame, pd.Series], Any]) -> Callable[[], Recording]:
    """change(frame, true position in mm) -> what stands in the error column, in um."""
    return _error(lambda f: change(f, f.x + f.EXX / 1000))


def _some(values: pd.Series, rows: pd.Series | np.ndarray, factor: float) -> pd.Series:
    return values.where(~np.asarray(rows, dtype=bool), values * factor)


def _after(f: pd.DataFrame, row: int, step: float) -> pd.Series:
    """The error column with a step from a row on, to the end of that row's run."""
    same = (f.run == f.run[row]) & (np.arange(len(f)) >= row)
    return f.EXX + step * same


def _swapped() -> Recording:
    recording = axis_test()
    return put(recording, x=recording.frame.EXX / 1000, EXX=recording.frame.x)


def _swapped_temperature() -> Recording:
    recording = axis_test()
    f = recording.frame
    return put(recording, T_nut=f.EXX, EXX=f.T_nut)


def _other_axis() -> Recording:
    recording = axis_test()
    kinds = {
        "x": Column(role="command", axis="Y", unit="mm"),
        "y": Column(role="command", axis="X", unit="mm"),
        "dir": Column(role="direction", axis="Y"),
    }
    manifest = recording.manifest.model_copy(update={"constants": {}})
    return declare(Recording(manifest, recording.frame), kinds)


def _no_own_axis() -> Recording:
    recording = axis_test()
    columns = {n: c for n, c in recording.manifest.columns.items() if n != "y"}
    columns["EXX"] = Column(role="error", component="EYY", unit="um")
    manifest = recording.manifest.model_copy(update={"columns": columns})
    return Recording(manifest, recording.frame.drop(columns="y"))


def _renamed(component: str) -> Callable[[], Recording]:
    return lambda: declare(axis_test(), {"EXX": Column(role="error", component=component, unit="um")})


def _rotary(change: Callable[[pd.DataFrame], Any]) -> Callable[[], Recording]:
    def made() -> Recording:
        recording = rotary_test()
        return put(recording, EXX=change(recording.frame))

    return made


def _compensated() -> Recording:
    recording = axis_test(warm=False)
    f = recording.frame
    on = f.run.isin(["run-4", "run-5"])
    read = put(recording, EXX=f.EXX.where(~on, 2 * f.EXX), state=np.where(on, "on", "off"))
    return declare(read, {"state": Column(role="group", of="compensation")})


def _overcompensated() -> Recording:
    """A double pass of the laser that was not halved: with its compensation on, the axis is as wrong the other way."""
    recording = axis_test(warm=False)
    f = recording.frame
    on = f.run.isin(["run-4", "run-5"])
    rest = f.EXX.mean() + 0.6 * np.random.default_rng(5).normal(size=len(f))
    read = put(recording, EXX=(2 * f.EXX).where(~on, 2 * (rest - f.EXX)), state=np.where(on, "on", "off"))
    return declare(read, {"state": Column(role="group", of="compensation")})


def shuffled(f: pd.DataFrame) -> pd.Series:
    """The error with the rows of the third run in a random order."""
    out = f.EXX.copy()
    rows = np.flatnonzero(f.run == "run-3")
    out[rows] = f.EXX[np.random.default_rng(8).permutation(rows)].to_numpy()
    return out


def _later(f: pd.DataFrame, by: int) -> pd.Series:
    return pd.Series(np.roll(f.EXX.to_numpy(), by))


def mirrored(f: pd.DataFrame) -> pd.Series:
    """The error with the rows of every way back in the opposite order."""
    turned = f.EXX.copy()
    for run in f.run.unique():
        rows = (f.run == run) & (f["dir"] < 0)
        turned[rows] = f.EXX[rows].to_numpy()[::-1]
    return turned


def _twice() -> Recording:
    """The first run again under another name."""
    recording = axis_test()
    f = recording.frame
    again = f[f.run == "run-1"]
    again = again.assign(run="again", t=f.t.max() + 12 + again.t)
    return Recording(recording.manifest, pd.concat([f, again], ignore_index=True))


def _first_run(change: Callable[[pd.DataFrame], Any]) -> Recording:
    """The first run alone with another error."""
    recording = axis_test()
    f = recording.frame[recording.frame.run == "run-1"].reset_index(drop=True)
    return Recording(recording.manifest, f.assign(EXX=np.asarray(change(f))))


@dataclass(frozen=True)
class Wrong:
    """declared: the mistake, in words; code: the refusal that must come; meant: words that its message must hold."""

    declared: str
    made: Callable[[], Recording]
    code: str
    meant: str


DIAL = axis_test  # a short name for the reader of the list: the same axis, read with a dial gauge

WRONG: tuple[Wrong, ...] = (
    # absolute readings in place of deviations
    Wrong(
        "dial readings (mm) as the error, in mm", _reading(lambda f, r: 1000 * r), "absolute-readings", "reading - comm"
    ),
    Wrong(
        "dial readings (mm) as the error, in um", _reading(lambda f, r: r), "absolute-readings", "unit is wrong as well"
    ),
    Wrong("dial readings (inch) as the error, in mm", _reading(lambda f, r: r / INCH * 1000), "absolute-readings", ""),
    Wrong(
        "dial readings (inch) as the error, in um",
        _reading(lambda f, r: r / INCH),
        "absolute-readings",
        "unit is wrong",
    ),
    Wrong(
        "readings that count the other way", _reading(lambda f, r: -1000 * r), "absolute-readings", "with reversed sign"
    ),
    Wrong(
        "an empty reading less the command",
        _reading(lambda f, r: -1000 * f.x),
        "absolute-readings",
        "with reversed sign",
    ),
    Wrong("-reading - command", _reading(lambda f, r: 1000 * (-r - f.x)), "absolute-readings", "of opposite sign"),
    Wrong(
        "reading in inch - command in mm",
        _reading(lambda f, r: 1e3 * (r / INCH - f.x)),
        "absolute-readings",
        "inch with",
    ),
    Wrong("reading in mm - command in inch", _reading(lambda f, r: 1e3 * (r - f.x / INCH)), "absolute-readings", ""),
    Wrong(
        "reading in um - command in mm", _reading(lambda f, r: 1e3 * (1e3 * r - f.x)), "absolute-readings", "in um with"
    ),
    Wrong(
        "reading in m - command in mm", _reading(lambda f, r: 1e3 * (1e-3 * r - f.x)), "absolute-readings", "in m with"
    ),
    Wrong(
        "radius - diameter", _reading(lambda f, r: 1e3 * (r / 2 - f.x)), "absolute-readings", "radius for a diameter"
    ),
    Wrong(
        "angle readings (deg) as the error", _rotary(lambda f: 17453.29 * f.x), "absolute-readings", "reading - command"
    ),
    # units of the error
    Wrong("mm declared as um", _error(lambda f: f.EXX / 1000), "too-small", "in mm that were declared as um"),
    Wrong("inch declared as um", _error(lambda f: f.EXX / 25400), "too-small", "declared as um"),
    Wrong("um declared as nm", _error(lambda f: f.EXX / 1000), "too-small", "um declared as nm"),
    Wrong("um declared as mm", _error(lambda f: f.EXX * 1000), "as-large-as-travel", "um declared as mm"),
    Wrong("um declared as inch", _error(lambda f: f.EXX * 25400), "as-large-as-travel", "um declared as mm"),
    Wrong(
        "one run in mm, the others in um",
        _error(lambda f: _some(f.EXX, f.run == "run-3", 1e-3)),
        "mixed-units",
        "mm and",
    ),
    Wrong(
        "one run in thousandths of an inch",
        _error(lambda f: _some(f.EXX, f.run == "run-2", 1 / INCH)),
        "mixed-units",
        "",
    ),
    Wrong(
        "one direction in another unit", _error(lambda f: _some(f.EXX, f["dir"] > 0, INCH)), "mixed-units", "inch and"
    ),
    # steps
    Wrong("a turn of the dial lost", _error(lambda f: _after(f, 64, 1000.0)), "jump", "one turn of a dial gauge"),
    Wrong("an inch lost", _error(lambda f: _after(f, 64, -25400.0)), "jump", "one inch"),
    Wrong("a tenth of an inch lost", _error(lambda f: _after(f, 64, 2540.0)), "jump", "0.1 inch"),
    # sign
    Wrong("readings zeroed half a metre away", _error(lambda f: f.EXX - 5e5), "other-zero", "another zero"),
    Wrong("commanded minus actual", lambda: with_actual(axis_test(), -1.0), "reversed-sign", "change the sign"),
    Wrong(
        "the error of actual and command, halved", lambda: with_actual(axis_test(), 1.0, 0.5), "reversed-sign", "unit"
    ),
    Wrong(
        "commanded minus actual, only temperatures beside", _error(lambda f: -f.EXX), "shrinks-when-warm", "get longer"
    ),
    Wrong("a compensation that is on with the wrong sign", _compensated, "worse-with-compensation", "other sign"),
    Wrong("an error twice as large as it is, compensated", _overcompensated, "worse-with-compensation", "twice"),
    Wrong("direction turned", _column("dir", lambda f: -f["dir"]), "reversed-direction", "from below"),
    Wrong(
        "direction turned in one run",
        _column("dir", lambda f: f["dir"].where(f.run != "run-3", -f["dir"])),
        "reversed-direction",
        "from below",
    ),
    # columns and axes
    Wrong("position and error swapped", _swapped, "as-large-as-travel", "exchanged columns"),
    Wrong("temperature and error swapped", _swapped_temperature, "not-a-temperature", "swapped"),
    Wrong("the position as error, in another unit", _error(lambda f: 0.05 * f.x), "copy-of-column", "another column"),
    Wrong("the temperature as error", _error(lambda f: 7 * f.T_nut), "copy-of-column", "another column"),
    Wrong("an error column that was not logged", _error(lambda f: 0 * f.x), "constant-deviation", "another column"),
    Wrong("the axes X and Y swapped", _other_axis, "wrong-axis", "component EYY"),
    Wrong("EYY measured along X", _renamed("EYY"), "wrong-axis", "component EXX"),
    Wrong("EYY without a position of Y", _no_own_axis, "wrong-axis", "component EXX"),
    Wrong(
        "the row number as the run", _column("run", lambda f: [str(i) for i in range(len(f))]), "run-per-row", "row num"
    ),
    # rows
    Wrong("errors one row late", _error(lambda f: _later(f, 1)), "shifted-rows", "row before"),
    Wrong("errors one row early", _error(lambda f: _later(f, -1)), "shifted-rows", "row after"),
    Wrong("errors three rows late", _error(lambda f: _later(f, 3)), "shifted-rows", "3 rows before"),
    # positions, time and temperatures
    Wrong("positions in inch declared as mm", _column("x", lambda f: f.x / INCH), "outside-travel", "inch"),
    Wrong("positions in m declared as mm", _column("x", lambda f: f.x / 1000), "as-large-as-travel", "position in m"),
    Wrong("positions in mm declared as inch", _column("x", lambda f: f.x * INCH), "outside-travel", "inch"),
    Wrong("positions in um declared as mm", _column("x", lambda f: f.x * 1000), "outside-travel", "um"),
    Wrong(
        "time in h declared as s",
        lambda: declare(
            put(axis_test(), t=12 / 3600 * np.arange(210)), {"x": Column(role="position", axis="X", unit="mm")}
        ),
        "too-fast",
        "ms, min or h",
    ),
    Wrong("kelvin declared as degC", _column("T_nut", lambda f: f.T_nut + 273.15), "temperature-range", "K"),
    Wrong("degF declared as degC", _column("T_nut", lambda f: 1.8 * f.T_air + 33), "temperature-range", "degF"),
    Wrong("one of two sensors in degF", _column("T_nut", lambda f: 1.8 * f.T_nut + 32), "temperature-range", "degF"),
    Wrong("tenths of a degree", _column("T_nut", lambda f: 10 * f.T_nut), "temperature-range", "tenths"),
    Wrong(
        "spindle speed as a temperature",
        _column("T_nut", lambda f: 8000.0 + f.t),
        "temperature-range",
        "another column",
    ),
    Wrong(
        "every temperature in degF",
        lambda: put(axis_test(), **{n: 1.8 * axis_test().frame[n] + 32 for n in ("T_nut", "T_air")}),
        "temperature-range",
        "degF",
    ),
    # among runs and directions
    Wrong(
        "one run of the other sign",
        _error(lambda f: _some(f.EXX, f.run == "run-3", -1.0)),
        "mixed-sign",
        "change their sign",
    ),
    Wrong("the way back in the order of the way there", _error(mirrored), "mirrored-rows", "order of the targets"),
    Wrong(
        "a direction that changes with every row",
        _column("dir", lambda f: np.where(f.index % 2, 1.0, -1.0)),
        "direction-not-of-motion",
        "another column",
    ),
    Wrong("0.1 um declared as um", _error(lambda f: 10 * f.EXX), "expands-too-much", "in 0.1 um"),
    Wrong(
        "three runs of five of the other sign",
        _error(lambda f: _some(f.EXX, f.run < "run-4", -1.0)),
        "mixed-sign",
        "change their sign",
    ),
    Wrong("a file imported twice, as another run", _twice, "copy-of-column", "imported twice"),
    Wrong(
        "positions of one run in inch",
        _column("x", lambda f: _some(f.x, f.run == "run-3", 1 / INCH)),
        "mixed-units",
        "inch",
    ),
    Wrong(
        "a reading filled in over half the travel",
        _error(lambda f: f.EXX.mask(f.x > 400, 7.25)),
        "constant-deviation",
        "a fill value",
    ),
    Wrong(
        "the row number as the position",
        _column("x", lambda f: 1.0 * f.index),
        "direction-not-of-motion",
        "counts the rows",
    ),
    Wrong("errors of one run in a random order", _error(shuffled), "shuffled-rows", "another order"),
    Wrong(
        "errors of a single run one row late",
        lambda: _first_run(lambda f: np.roll(f.EXX, 1)),
        "shifted-rows",
        "row before",
    ),
    Wrong(
        "a single run, its way back in the order of the targets",
        lambda: _first_run(mirrored),
        "mirrored-rows",
        "return pass",
    ),
)


def page() -> str:
    """The list as `docs/wrong-declarations.md`: what was declared, and the refusal that names it."""
    from errpipe.validation import plausibility

    lines = [
        "# Wrong declarations, and how each is refused",
        "",
        "For users whose export was refused: which mistakes in a recording are detected, under which name.",
        "",
        "Deviation is actual minus commanded. Each mistake was made in a bidirectional test of an axis (five",
        "runs, 21 targets, 800 mm) and refused at the export stage with exit code 4 (`errpipe explain NAME`).",
        "If a declaration is correct although it looks wrong, `export: {allow: [NAME]}` accepts it.",
        "Generated by `python -m tests.unit.validation.wrong_declarations`; every row is a test",
        "(`tests/unit/validation/test_plausibility.py`).",
        "",
        "| declared | name of the refusal | message |",
        "| --- | --- | --- |",
    ]
    for wrong in WRONG:
        first = next(f for f in plausibility.findings(wrong.made()) if f.code == wrong.code)
        lines.append(f"| {wrong.declared} | `{wrong.code}` | {first.found}; probably meant: {first.meant} |")
    lines.append(
        "| a correction of -300 mm at 300 mm | `beyond-limit` | any correction beyond `export: {limit: ...}`, by"
        " default 0.5 mm or 1/1000 of the travel |"
    )
    return "\n".join([*lines, "", *UNKNOWABLE, ""])


UNKNOWABLE = (
    "## What a recording cannot show",
    "",
    "The following mistakes cannot be detected, because a correct recording could contain the same values.",
    "",
    "* Two temperature sensors exchanged in all runs. The model uses the one that correlates with the error, under",
    "  either name; its table then reads the wrong sensor of the machine. Before the compensation is activated, warm",
    "  each sensor by hand.",
    "* A factor of 2 on every reading (radius and diameter, a double pass of a laser that was not halved), without the",
    "  actual position. It is detected if the recording includes runs with active compensation (above), and",
    "  at the three points of every checklist.",
    "* The rows of every run in random order. On a held-out run the model then predicts little more than the mean,",
    "  which is correct; the noise floor in the report is as large as the error itself.",
    "* The sign, without both positions, temperatures or lost motion: `import` asks for it.",
)


if __name__ == "__main__":
    from pathlib import Path

    (Path(__file__).parents[3] / "docs" / "wrong-declarations.md").write_text(page(), encoding="utf-8")
