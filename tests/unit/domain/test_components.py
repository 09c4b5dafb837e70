"""ISO 230-1 names."""

import pytest

from errpipe.domain import components


@pytest.mark.parametrize(
    ("name", "kind", "unit"),
    [
        ("EXX", "positioning", "um"),
        ("EYX", "straightness", "um"),
        ("EAX", "roll", "urad"),
        ("EBX", "tilt", "urad"),
        ("ECX", "tilt", "urad"),
        ("EZC", "axial", "um"),
        ("EXC", "radial", "um"),
        ("ECC", "angular positioning", "urad"),
        ("EAC", "tilt", "urad"),
        ("C0Y", "squareness", "urad"),
        ("X0C", "axis offset", "um"),
        ("A0C", "squareness", "urad"),
        ("C0C", "zero position", "urad"),
        ("X0X", "drift", "um"),
        ("X0S", "drift", "um"),
        ("A0S", "drift", "urad"),
        ("E_Z", "tool point", "um"),
        ("E_A", "tool orientation", "urad"),
        ("E_R", "circular", "um"),
        ("E_D", "diameter", "um"),
        ("F_X", "force", "N"),
        ("F_C", "force", "N m"),
        ("EXU", "positioning", "um"),
        ("ECS", "angular positioning", "urad"),
        ("EXX1", "positioning", "um"),
    ],
)
def test_names_mean_what_iso_230_1_says(name, kind, unit):
    assert (components.parse(name).kind, components.unit(name)) == (kind, unit)
    assert components.describe(name)


@pytest.mark.parametrize(
    ("alias", "name"),
    [("E_X0C", "X0C"), ("EX0C", "X0C"), ("E_{X0C}", "X0C"), ("EC0Y", "C0Y"), ("E_XX", "EXX"), ("E_{BX}", "EBX")],
)
def test_the_other_spellings_are_the_same_component(alias, name):
    assert components.parse(alias) == components.parse(name)
    assert components.parse(alias).name == name


def test_a_wrong_name_gets_the_nearest_right_one():
    with pytest.raises(ValueError, match=r"Did you mean EXX\?"):
        components.parse("exx")
    for of_a_parallel_axis, meant in (("EUU", "EXU"), ("E_WW", "EZW"), ("EVU", "EYU")):
        with pytest.raises(ValueError, match=rf"Did you mean {meant}\?"):
            components.parse(of_a_parallel_axis)
    with pytest.raises(ValueError, match=r"'EXT' is not an ISO 230-1 component"):
        components.parse("EXT")


def test_how_many_a_machine_has():
    for linear, rotary, count in [("XYZ", "", 21), ("XYZ", "AC", 43), ("XZ", "", 13), ("X", "B", 17)]:
        names = components.of_machine(tuple(linear), tuple(rotary))
        assert len(set(names)) == len(names) == count
        assert all(components.parse(n).name == n for n in names)


def test_squareness_turns_about_the_third_axis():
    assert components.of_machine()[-3:] == ("C0Y", "B0Z", "A0Z")
    assert components.of_machine(("X",), ("C",))[-5:] == ("X0C", "Y0C", "A0C", "B0C", "C0C")


@pytest.mark.parametrize(
    ("name", "output"),
    [
        ("C0Y", "squareness of Y: its direction, turned about Z"),
        ("A0C", "squareness of the axis line of C: tilted about X"),
        ("C0C", "zero position of C: turned about its own line where it reads 0"),
        ("X0C", "offset of the axis line of C in the X direction"),
        ("X0X", "drift of the origin of X's frame in the X direction"),
        ("Y0X", "drift of the origin of X's frame in the Y direction"),
        ("Z0S", "growth of the spindle in the Z direction"),
        ("A0S", "tilt of the spindle about X"),
    ],
)
def test_location_errors_are_reported_as_what_they_are(name, output):
    assert components.describe(name) == output


def test_axes_that_turn():
    assert [a for a in ("X", "U", "R", "A", "A2", "C1", "D", "E", "S", "S1") if components.is_rotary(a)] == [
        *("A", "A2", "C1", "D", "E", "S", "S1")
    ]


def test_positioning_of_an_axis():
    assert [components.positioning(a) for a in ("X", "U", "X1", "C")] == ["EXX", "EXU", "EXX1", "ECC"]
    assert components.parse(components.positioning("W")).kind == "positioning"


def test_a_torque_may_stand_in_newton_at_a_radius():
    assert components.allowed_units("F_C") == ("N m", "N")
    assert components.allowed_units("F_X") == ("N",)
    assert components.describe("F_C") == "drive torque of C"
