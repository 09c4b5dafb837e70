"""Where a straightness was read, along its axis and along the others: the angle there is part of the reading."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml
from numpy.testing import assert_allclose
from records_played import solve

from errpipe.domain.machine import Machine
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.kinematics import direct, identify, readings, records, synthesis
from errpipe.kinematics.chain import compile_chain


@pytest.mark.parametrize("axis", ["X", "X'"])
@pytest.mark.parametrize("reference_on", ["carriage", "guideway"])
@pytest.mark.parametrize("read_on", ["carriage", "guideway"])
def test_a_straightness_is_that_of_the_tool_wherever_the_gauge_was(axis, reference_on, read_on):
    """The gauge at the tool: it travels with an axis that moves the tool and stands beside one that moves the work."""
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZ"}
    axes["X"]["reference_on"] = reference_on
    given = {"machine": 1, "name": "m", "chain": ["workpiece", axis, "bed", "Y", "Z", "tool"], "axes": axes}
    if axis == "X":
        given["chain"] = ["workpiece", "bed", "X", "Y", "Z", "tool"]
    chain = compile_chain(Machine.model_validate(given | {"tool": {"length": 0}}))
    x = np.linspace(0, 500, 21)
    angle, straightness = 30.0 * np.sin(x / 90.0), 8.0 * np.cos(x / 70.0)
    components = np.zeros((21, len(chain.components)))
    components[:, chain.index("ECX")], components[:, chain.index("EYX")] = angle, straightness
    q = np.column_stack([x, np.zeros(21), np.zeros(21)])
    at_tool = synthesis.first_order(chain, q, components)[:, 1]
    gauge_at_tool = "carriage" if axis == "X" else "guideway"
    reading = at_tool if read_on == gauge_at_tool else at_tool - x * angle * 1e-3
    columns = {
        "x": Column(role="position", axis="X", unit="mm"),
        "EYX": Column(role="error", component="EYX", unit="um"),
        "ECX": Column(role="error", component="ECX", unit="urad"),
    }
    frame = pd.DataFrame({"x": x, "EYX": reading, "ECX": angle})
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)
    solution = solve(chain, recording, lasers={"EYX": direct.Laser(read_on=read_on)})
    found = synthesis.first_order(chain, q, solution.errors().at(q))[:, 1]
    rest = found - at_tool
    assert_allclose(rest - np.polyval(np.polyfit(x, rest, 1), x), 0.0, atol=0.4)


@pytest.mark.parametrize("place, squareness", [(450.0, True), (None, False)])
def test_the_angle_of_another_axis_where_a_line_was_read_is_no_squareness(place, squareness):
    """Z read against the square at X = 450, where the carriage of X is turned by -19 urad: B0Z of 7 urad is found."""
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZ"}
    given = {"machine": 1, "name": "m", "chain": ["workpiece", "bed", "X", "Y", "Z", "tool"], "axes": axes}
    chain = compile_chain(Machine.model_validate(given | {"tool": {"length": 0}}))
    p = np.linspace(0, 500, 21)

    def line(axis, **columns):
        q = np.zeros((21, 3))
        q[:, chain.axes.index(axis)] = p
        if axis == "Z":
            q[:, chain.axes.index("X")] = 450.0
        components = np.zeros((21, len(chain.components)))
        turned = 20.0 * np.cos(np.pi * q[:, chain.axes.index("X")] / 500.0)  # no mean, as the levels' zero has it
        components[:, chain.index("EBX")], components[:, chain.index("B0Z")] = turned, 7.0
        deviation = synthesis.first_order(chain, q, components)
        frame = pd.DataFrame({axis.lower(): p} | {n: deviation[:, k] for n, k in columns.items()})
        kinds = {axis.lower(): Column(role="position", axis=axis, unit="mm")}
        kinds |= {n: Column(role="error", component=n, unit="urad" if k > 2 else "um") for n, k in columns.items()}
        if axis == "Z" and place is not None:
            frame["x"], kinds["x"] = place, Column(role="position", axis="X", unit="mm")
        return Recording(Manifest(recording=1, tables=("t.csv",), columns=kinds), frame)

    tests = {"z": line("Z", EXZ=0), "x": line("X", EZX=2, EBX=4)}
    without = tuple(n for n in chain.components if n not in ("EXZ", "EZX", "EBX", "B0Z"))
    seen = records.observations(chain, tests, squares={"B0Z": 0.0})
    solved = identify.identify(identify.Parametrisation.of(chain, 12, without), seen)
    found = solved.component("B0Z")[0][0]
    assert (abs(found - 7.0) < 1.5) == squareness
    says = readings.squareness_uncertainty(chain, tests, {"B0Z": 0.0}, solved.errors())
    assert ("B0Z by up to 20" in says and "EXZ has no position of X" in says) != squareness


@pytest.mark.parametrize(("chain", "asked"), [("workpiece X' bed Y Z tool", True), ("workpiece bed X Y Z tool", False)])
def test_where_a_straightness_of_a_table_was_read_is_asked_if_it_matters(chain, asked):
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZ"}
    machine = Machine.model_validate({"machine": 1, "name": "m", "chain": chain.split(), "axes": axes})
    x = np.linspace(0, 500, 21)
    columns = {
        "x": Column(role="position", axis="X", unit="mm"),
        "EYX": Column(role="error", component="EYX", unit="um"),
        "ECX": Column(role="error", component="ECX", unit="urad"),
    }

    def ask(size, **said):
        frame = pd.DataFrame({"x": x, "EYX": 0.0 * x, "ECX": size * np.sin(x / 90.0)})
        test = {"t": Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)}
        direct.refuse_unstated_places(compile_chain(machine), test, {"EYX": direct.Laser(**said)} if said else {})

    for stated in ({"read_on": "carriage"}, {"read_on": "guideway"}):
        ask(30.0, **stated)
    ask(0.5)
    if not asked:
        return ask(30.0)
    for said in ({}, {"offset": (0.0, 0.0, 10.0)}):
        with pytest.raises(DataError, match=r"EYX: the work travels on X, which turns it.*differs by 11.8 um"):
            ask(30.0, **said)


def table_of_x(**values):
    """A machine whose table is X, and a recording along X of components by name."""
    axes = {a: {"kind": "linear", "travel": [0, 500]} for a in "XYZ"}
    given = {"machine": 1, "name": "m", "chain": ["workpiece", "X'", "bed", "Y", "Z", "tool"], "axes": axes}
    units = {n: "um" if n[1] in "XYZ" else "urad" for n in values}
    columns = {n: Column(role="error", component=n, unit=unit) for n, unit in units.items()}
    columns["x"] = Column(role="position", axis="X", unit="mm")
    frame = pd.DataFrame({"x": np.linspace(0, 500, 21)} | values)
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)
    return compile_chain(Machine.model_validate(given)), {"t": recording}


def test_every_straightness_of_the_table_is_asked_at_once_and_the_answer_is_taken():
    x = np.linspace(0, 500, 21)
    turns = {"EBX": 30.0 * np.sin(x / 90.0), "ECX": 30.0 * np.sin(x / 90.0)}
    chain, test = table_of_x(EYX=0 * x, EZX=0 * x, **turns)
    with pytest.raises(
        DataError,
        match=r"^EYX, EZX: the work travels on X, which turns it.*EYX: \{read_on: carriage\}, EZX: \{read_on: carriage",
    ) as e:
        direct.refuse_unstated_places(chain, test, {})
    answer = yaml.safe_load(str(e.value).partition("stage: ")[2].partition(" for the table")[0])["lasers"]
    direct.refuse_unstated_places(chain, test, {n: direct.Laser(**said) for n, said in answer.items()})


def test_a_column_with_two_readings_or_of_an_unknown_axis_does_not_ask_where_it_was_read():
    x = np.linspace(0, 500, 21)
    chain, test = table_of_x(EXX=np.where(x < 30, 1.0, np.nan), EYX=0 * x, ECX=0 * x)
    direct.refuse_unstated_places(chain, test, {})
    assert len(records.read(chain, test)) == 3
    columns = {"w": Column(role="position", axis="W", unit="mm"), "e": Column(role="error", component="EYW", unit="um")}
    manifest = Manifest(recording=1, tables=("t.csv",), columns=columns)
    direct.refuse_unstated_places(chain, {"w": Recording(manifest, pd.DataFrame({"w": x, "e": x}))}, {})
