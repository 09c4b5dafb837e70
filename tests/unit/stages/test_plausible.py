"""What is implausible is not exported, and every checklist says what will happen in one sentence."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from errpipe.api import Table
from errpipe.errors import GateError, VerifyError
from errpipe.stages import targets
from errpipe.tables import ect
from tests.unit.tables.made import follower
from tests.unit.targets.machines import (
    compile_,
    long_with_lost_motion,
    straight,
    too_long_at_plus_x,
    too_long_from_above,
)


@pytest.mark.parametrize("name", ["linuxcnc_screw", "sinumerik_lec", "heidenhain_com", "iec_st"])
def test_a_checklist_says_what_will_happen(tmp_path: Path, name: str) -> None:
    ect.write(too_long_at_plus_x(), tmp_path / "table.ect")
    done = targets.export(tmp_path / "table.ect", [name], tmp_path / "out")
    text = (tmp_path / "out" / name / targets.CHECKLIST).read_text()
    (says,) = re.findall(r"- (at X = .*)[.]", text)
    wanted = "at X = 500 mm the axis stands 10.0 um too far and will be commanded 10.0 um less"
    assert says == wanted and done["says"][-1] == f"{name}: {wanted}"


@pytest.mark.parametrize("table", [too_long_from_above, long_with_lost_motion])
def test_a_checklist_names_a_side_only_where_sides_differ(tmp_path: Path, table: Any) -> None:
    """It said `approached from below` of every table, also of one that was measured only from above."""
    ect.write(table(), tmp_path / "table.ect")
    ect.write(too_long_at_plus_x(), tmp_path / "one.ect")
    both, one = (
        targets.export(tmp_path / f"{name}.ect", ["linuxcnc_screw"], tmp_path / name)["says"][-1]
        for name in ("table", "one")
    )
    assert " approached from above the axis" in both and "approached" not in one


def test_a_machine_too_short_is_commanded_further(tmp_path: Path) -> None:
    ect.write(compile_(("EXX", [straight("X", -10.0)])), tmp_path / "table.ect")
    says = targets.export(tmp_path / "table.ect", ["linuxcnc_screw"], tmp_path / "out")["says"][-1]
    assert says.endswith("the axis stands 10.0 um short and will be commanded 10.0 um further")


def test_an_axis_whose_values_all_round_to_zero_is_named(tmp_path: Path) -> None:
    """0.4 um are less than half a pulse of 1 um."""
    ect.write(compile_(("EXX", [straight("X", 0.4)]), ("EYY", [straight("Y", 10.0, 400.0)])), tmp_path / "table.ect")
    says = targets.export(tmp_path / "table.ect", ["fanuc_pitch"], tmp_path / "out")["says"]
    wanted = "X is not corrected: each of its values in these files is 0 (the largest correction of the table, 0.4 um"
    text = (tmp_path / "out" / "fanuc_pitch" / targets.CHECKLIST).read_text()
    assert wanted in text and any(wanted in line for line in says)
    assert "Y is not corrected" not in text


def test_a_table_beyond_the_limit_is_refused_and_allowed_by_name(tmp_path: Path) -> None:
    ect.write(compile_(("EXX", [straight("X", 300_000.0)])), tmp_path / "table.ect")
    with pytest.raises(GateError, match=r"the correction reaches 3e[+]05 um, the limit is 500"):
        targets.export(tmp_path / "table.ect", ["linuxcnc_screw"], tmp_path / "out")
    assert not (tmp_path / "out").exists()
    targets.export(tmp_path / "table.ect", ["linuxcnc_screw"], tmp_path / "out", ["beyond-limit"])
    with pytest.raises(GateError):
        targets.export(tmp_path / "table.ect", ["linuxcnc_screw"], tmp_path / "out2", limit=9.0)


def test_a_table_that_nothing_limits_is_refused(tmp_path: Path) -> None:
    """A correction that follows the position without a profile has no end at which to look for its largest."""
    for magnitude in (None, 50_000.0):
        ect.write(follower(magnitude), tmp_path / "table.ect")
        with pytest.raises(GateError, match=r"the correction reaches \S+ um, the limit is 500"):
            targets.export(tmp_path / "table.ect", ["linuxcnc_hal", "c_runtime", "iec_st"], tmp_path / "out")
        with pytest.raises(VerifyError, match="EXX is corrected without magnitude or slew, or beyond 10 mm"):
            Table.read(tmp_path / "table.ect").cycle()
    assert not (tmp_path / "out").exists()
    assert Table(follower(None)).cycle(unlimited=True).outputs == ("EXX",)
    assert Table(follower(10_000.0)).cycle().outputs == ("EXX",)


def test_a_table_that_may_jump_says_so_and_runs_only_where_it_is_named(tmp_path: Path) -> None:
    """A magnitude alone lets an encoder's jump through in one cycle."""
    ect.write(follower(100.0, None), tmp_path / "table.ect")
    with pytest.raises(VerifyError, match="EXX is corrected without magnitude or slew"):
        Table.read(tmp_path / "table.ect").cycle()
    says = targets.export(tmp_path / "table.ect", ["c_runtime"], tmp_path / "out")["says"]
    output = [says, [(tmp_path / "out" / "c_runtime" / "CHECKLIST.md").read_text()]]
    assert all("EXX: the table states no slew" in "".join(lines) for lines in output)
    ect.write(follower(100.0, 1000.0), tmp_path / "slow.ect")
    assert "no slew" not in "".join(targets.export(tmp_path / "slow.ect", ["c_runtime"], tmp_path / "out2")["says"])
