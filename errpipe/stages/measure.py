"""Measuring plans and circular tests: what to measure next, and what a metrologist reads off a ball bar."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any


def measure(machine: Path, out: Path, without: Sequence[str], positions: int) -> dict[str, Any]:
    """A telescoping-bar plan that shows every component of a machine in the least time, as a G-code program."""
    from errpipe import jsonfile, yamlfile
    from errpipe.domain.machine import Machine
    from errpipe.kinematics import plan
    from errpipe.kinematics.chain import compile_chain

    chain = compile_chain(yamlfile.load(Path(machine), Machine))
    unknown = [c for c in without if c not in chain.components]
    if unknown:
        from errpipe.errors import UsageError, did_you_mean

        near = did_you_mean(unknown[0], chain.components)
        raise UsageError(f"--without {unknown[0]}: {chain.machine.name} has no such component.{near}")
    found = plan.propose(chain, without=tuple(without), positions=positions)
    jsonfile.write_text(Path(out), plan.program(found))
    return {
        "written": str(out),
        "components": len(chain.components) - len(without),
        "blocks": len(found.blocks),
        "positions": sum(len(b.q) for b in found.blocks),
        "minutes": round(found.minutes, 1),
        "unseen": [u.says() for u in found.open],
    }


def ballbar_pages(recording: Any) -> list[tuple[str, str, str]]:
    """A polar plot per plane of a circular test, with G and F and what is read off it: heading, figure, caption."""
    from errpipe.reporting import machine_figures
    from errpipe.validation import iso230_4

    circles = iso230_4.circles(recording)
    out = []
    for test in iso230_4.evaluate(recording):
        plane = test.figures.plane
        own = [c for c in circles if "".join(c.plane) == "".join(plane)]
        found = test.figures
        lines = [f"G {run}: {value:.1f} um" for run, value in found.circular.items()]
        lines += [f"F {run}: {low:+.1f} to {high:+.1f} um" for run, (high, low) in found.radial.items()]
        lines += [f"G both ways: {found.both:.1f} um"] if found.both is not None else []
        lines += [
            f"{e.effect.replace('_', ' ')} {e.where}: {e.value:.1f} ({e.ci95[0]:.1f} to {e.ci95[1]:.1f}) {e.unit}"
            for e in test.effects
        ]
        drawn = [(c.label, c.angle, c.deviation) for c in own]
        name = "".join(plane)
        figure = machine_figures.ballbar(drawn, own[0].radius, lines, f"Circular test {name}")
        out.append((f"Circular test {name}", figure, "ISO 230-4 figures, and what a metrologist reads off the plot."))
    return out
