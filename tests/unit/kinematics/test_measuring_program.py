"""A measuring program, read line by line: what the machine does with a bar attached, and without one."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from machines import ready

from errpipe.kinematics import measuring_program, plan, synthesis
from errpipe.kinematics.chain import compile_chain

MACHINES = (
    "cmm", "vertical-centre", "turning-centre",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("five-axis-head-head", "five-axis-table-table")),
)  # fmt: skip
FINE = 400  # points of a move


@cache
def planned(name):
    return plan.propose(ready(name), positions=20)


def points(proposed, start, end, block, length=None):
    chain = proposed.chain
    tip = chain.tip(block.length, block.offset) if length is None else chain.tip(length, (0.0, 0.0, 0.0))
    q = np.linspace(start, end, FINE)
    return synthesis.ideal_pose(chain, q, tip)[:, 0]


def moves(text, axes):
    """Of each motion: start (NaN where not yet known), end, F, length of the bar attached or None, block number."""
    at, bar, number, leaving = np.full(len(axes), np.nan), None, 1, False
    for line in text.splitlines():
        if m := re.fullmatch(r"M0 \(MSG, attach the bar: ([\d.]+) mm, block (\d+)\)", line):
            assert bar is None and number == int(m[2])
            bar = float(m[1])
        elif line.startswith("M0 (MSG, detach the bar"):
            assert bar is not None
            bar, leaving = None, True
        elif line.startswith(("M0 (MSG, place the socket", "M0 (MSG, ball at length")):
            assert bar is None
        elif line.startswith("G1 "):
            words = dict(re.findall(r"([A-Z])(-?[\d.]+)", line[3:]))
            feed, start = float(words.pop("F")), at.copy()
            for letter, value in words.items():
                at[axes.index(letter)] = float(value)
            yield start, at.copy(), feed, bar, number
            number, leaving = number + leaving, False
    assert bar is None


@pytest.mark.parametrize("name", MACHINES)
def test_an_attached_bar_stays_within_its_reach_and_above_the_socket(name):
    proposed = planned(name)
    towards = np.asarray(proposed.chain.machine.tool.direction)
    before = None
    for start, end, feed, bar, number in moves(measuring_program.program(proposed), proposed.chain.axes):
        if bar is None:
            before = None
            continue
        block = proposed.blocks[number - 1]
        ball = points(proposed, start, end, block)
        size = np.linalg.norm(ball - block.socket, axis=1)
        if before is None:
            assert size[0] == pytest.approx(bar, abs=1e-3)
        before = bar
        assert size.min() >= proposed.equipment.reach[0] and size.max() <= proposed.equipment.reach[1]
        assert ((block.socket - ball) @ towards).min() > 15.0
        assert ((block.socket - points(proposed, start, end, block, 0.0)) @ towards).min() > 15.0
        seconds = duration(proposed.chain, start, end, feed)
        way = np.linalg.norm(np.diff(ball, axis=0), axis=1).sum()
        assert way <= 1.01 * proposed.equipment.feed / 60.0 * seconds + 0.01


def duration(chain, start, end, feed):
    """As LinuxCNC counts F (G94): along the linear axes, of the rotary ones if none of these moves."""
    kinds = np.array([chain.machine.axes[a].kind == "linear" for a in chain.axes])
    return (np.linalg.norm((end - start)[kinds]) or np.linalg.norm(end - start)) / feed * 60.0


@pytest.mark.parametrize("name", MACHINES)
def test_without_a_bar_one_axis_moves_at_a_time_and_clear_of_the_socket(name):
    proposed = planned(name)
    text = measuring_program.program(proposed)
    low, high = proposed.chain.travel.T
    checked = 0
    for start, end, feed, bar, number in moves(text, proposed.chain.axes):
        known = ~np.isnan(end)
        assert (end[known] >= low[known]).all() and (end[known] <= high[known]).all()
        if bar is not None:
            continue
        assert np.sum((start != end) & known) <= 1 and feed == proposed.equipment.approach_feed
        if not np.isnan(start).any() and number <= len(proposed.blocks):
            block = proposed.blocks[number - 1]
            size = np.linalg.norm(points(proposed, start, end, block) - block.socket, axis=1)
            assert size.min() >= 45.0
            checked += 1
    assert checked >= 2 * len(proposed.blocks)
    attached, detached = text.count("attach the bar: "), text.count("(MSG, detach the bar")
    assert attached == detached == len(proposed.blocks)


@pytest.mark.parametrize("name", MACHINES)
def test_socket_and_ball_are_placed_with_the_tool_retracted(name):
    proposed = planned(name)
    lines = measuring_program.program(proposed).splitlines()
    away = next(line for line in lines if line.startswith("G1 "))
    for i, line in enumerate(lines):
        if "place the socket" in line or "ball at length" in line:
            assert next(p for p in reversed(lines[:i]) if not p.startswith("M0")) == away
        if "detach the bar" in line:
            assert lines[i + 1] == away
    assert [p for p in lines if p.startswith("G1 ")][-1] == away and lines[-2:] == ["M2", "%"]
    (zone,) = [re.findall(r"[XYZ](-?[\d.]+)", line) for line in lines if "sockets lie from" in line]
    low, high = np.array(zone, dtype=float).reshape(3, 2).T
    sockets = np.array([b.socket for b in proposed.blocks])
    assert np.allclose(low, sockets.min(axis=0), atol=1e-3) and np.allclose(high, sockets.max(axis=0), atol=1e-3)
    number = proposed.chain.axes.index(away[3])
    q = proposed.chain.travel.mean(axis=1)
    end = q.copy()
    end[number] = float(re.search(r"-?[\d.]+", away[3:])[0])
    moved = points(proposed, q, end, proposed.blocks[0])
    assert (moved[-1] - moved[0]) @ np.asarray(proposed.chain.machine.tool.direction) < 0.0


def test_a_way_past_the_socket_is_not_driven_without_a_stop():
    proposed = planned("cmm")
    second = proposed.blocks[1]
    ball_retracted = second.socket - second.clearance.bar(second.clearance.retracted(second.q[0])[None])[0]
    narrow = replace(second, clearance=replace(second.clearance, socket=ball_retracted - [0.0, 0.0, 40.0]))
    text = measuring_program.program(replace(proposed, blocks=(proposed.blocks[0], narrow)))
    assert "passes the socket: jog there" in text
    assert "passes the socket" not in measuring_program.program(proposed)


def test_a_name_does_not_end_its_comment():
    chain = ready("cmm")
    named = compile_chain(chain.machine.model_copy(update={"name": "a) G0 Z-600 (b\nG0 X1"}))
    text = measuring_program.program(replace(planned("cmm"), chain=named))
    assert "(measuring plan for a_ G0 Z-600 _b_G0 X1: " in text


@pytest.mark.toolchain
@pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC's interpreter rs274 is not installed")
@pytest.mark.parametrize("name", ["cmm", pytest.param("five-axis-head-head", marks=pytest.mark.slow)])
def test_linuxcnc_reads_the_program(name, tmp_path):
    proposed = planned(name)
    text = measuring_program.program(proposed)
    (tmp_path / "p.ngc").write_text(text)
    run = subprocess.run(["rs274", "-g", "p.ngc"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert "PROGRAM_END" in run.stdout, run.stdout[-500:] + run.stderr
    assert len(re.findall(r"STRAIGHT_FEED\(", run.stdout)) == len(re.findall(r"^G1 ", text, re.M))
    assert run.stdout.count("PROGRAM_STOP") == text.count("M0 (MSG")
    assert len(re.findall(r"MESSAGE\(", run.stdout)) == text.count("(MSG")
