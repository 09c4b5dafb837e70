"""Measuring plans and circular tests: what to measure next, and what a metrologist reads off a ball bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from errpipe import jsonfile, yamlfile
from errpipe.domain.machine import Machine
from errpipe.errors import UsageError, did_you_mean
from errpipe.kinematics import measuring_program, plan
from errpipe.kinematics.chain import compile_chain
from errpipe.kinematics.clearance import MARGIN
from errpipe.reporting import machine_figures
from errpipe.validation import iso230_4


def measure(
    machine: Path, out: Path, without: Sequence[str], positions: int, reach: tuple[float, float]
) -> dict[str, Any]:
    """A telescoping-bar plan that shows every component of a machine in the least time, as a G-code program.

    reach: shortest and longest length of the bar, mm.
    """
    if not 0.0 < reach[0] < reach[1] - 2 * MARGIN < math.inf:
        raise UsageError(
            f"--reach {reach[0]:g} {reach[1]:g}: not the shortest and longest length of a bar, mm"
            f" (above 0, more than {2 * MARGIN:g} mm apart)"
        )
    chain = compile_chain(yamlfile.load(Path(machine), Machine))
    unknown = [c for c in without if c not in chain.components]
    if unknown:
        near = did_you_mean(unknown[0], chain.components)
        raise UsageError(f"--without {unknown[0]}: {chain.machine.name} has no such component.{near}")
    proposal = plan.propose(
        chain,
        equipment=plan.Equipment(tools=plan.default_tools(chain), reach=reach),
        without=tuple(without),
        positions=positions,
    )
    jsonfile.write_text(Path(out), measuring_program.program(proposal))
    return {
        "written": str(out),
        "components": len(chain.components) - len(without),
        "blocks": len(proposal.blocks),
        "positions": sum(len(b.q) for b in proposal.blocks),
        "bar": f"{reach[0]:g} to {reach[1]:g} mm",
        "minutes": round(proposal.minutes, 1),
        "unseen": [u.sentence() for u in proposal.open],
    }


def ballbar_pages(recording: Any) -> list[tuple[str, str, str]]:
    """A polar plot per plane of a circular test, with G and F and what is read off it: heading, figure, caption.

    Plot and F count from each full circle's own least-squares centre (ISO 230-4 allows it): where the bar stood is
    set-up.
    """
    circles = iso230_4.circles(recording)
    out = []
    for test in iso230_4.evaluate(recording):
        figures, name = test.figures, "".join(test.figures.plane)
        of_plane = [c for c in circles if "".join(c.plane) == name]
        drawn, lines = [], []
        for c in of_plane:
            deviation, close = iso230_4.centred(c), slice(0, 1 if iso230_4.is_full(c) else 0)
            drawn.append((c.label, np.r_[c.angle, c.angle[close]], np.r_[deviation, deviation[close]]))
            g = f"G {c.label}: {figures.circular[c.label]:.1f} um, " if c.label in figures.circular else ""
            lines.append(f"{g}F {c.label}: {deviation.min():+.1f} to {deviation.max():+.1f} um")
        lines += [f"G both ways: {figures.both:.1f} um"] if figures.both is not None else []
        lines += [f"hysteresis H: {figures.hysteresis:.1f} um"] if figures.hysteresis is not None else []
        lines += [
            f"{e.effect.replace('_', ' ')} {e.where}: {e.value:.1f} ({e.ci95[0]:.1f} to {e.ci95[1]:.1f}) {e.unit}"
            for e in test.effects
        ]
        figure = machine_figures.ballbar(drawn, of_plane[0].radius, lines, f"Circular test {name}")
        out.append((f"Circular test {name}", figure, _reading(test)))
    return out


def _reading(test: Any) -> str:
    """Reading of a plane, the largest part of the plot first, and the effects whose interval includes 0."""
    significant = [e.says for e in test.effects if e.ci95[0] * e.ci95[1] > 0]
    not_significant = [f"{e.effect.replace('_', ' ')} {e.where}" for e in test.effects if e.ci95[0] * e.ci95[1] <= 0]
    summary = (
        f"Read off the plot, largest first: {'; '.join(significant)}."
        if significant
        else "No systematic error is visible."
    )
    addition = f" Not significant (95 %): {', '.join(not_significant)}." if not_significant else ""
    return (
        f"After ISO 230-4, each circle about its own centre. {summary}{addition} As it appears where "
        f"these circles lie: angles elsewhere in the volume add to it. The residual is {test.noise:.1f} um rms."
    )
