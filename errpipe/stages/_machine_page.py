"""An identification solved and shown: one document, and one page a metrologist reads from top to bottom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from errpipe import __version__, jsonfile, yamlfile
from errpipe.domain.machine import Machine
from errpipe.errors import UsageError
from errpipe.fitting.solve import one_thread
from errpipe.kinematics import direct, identify, readings, records, residual_error, summary, synthesis
from errpipe.kinematics.chain import Chain, compile_chain
from errpipe.kinematics.errors import MachineErrors, positions_of
from errpipe.kinematics.identify import Identified
from errpipe.kinematics.residual_error import CompensationEffect
from errpipe.pipeline.stage import Context
from errpipe.reporting import machine_figures
from errpipe.reporting.page import render
from errpipe.stages import _artefacts
from errpipe.stages.measure import ballbar_pages


@dataclass(frozen=True)
class Solved:
    """An identification (`found`) with its inputs. remaining: residual error, of a simulated machine only."""

    chain: Chain
    found: Identified
    document: dict[str, Any]
    tests: dict[str, Any]
    remaining: CompensationEffect | None


@one_thread()  # two on a busy machine take ten times as long, and their last bits change
def solve(stage: Any, context: Context) -> Solved:
    """Read every test, identify, and state the residual. Raises DataError for a test that cannot be read."""
    chain = compile_chain(yamlfile.load(stage.machine, Machine))
    tests = _artefacts.recordings_in(context)
    single = {name: r for name, r in tests.items() if records.is_direct(r)}
    if not single and (stage.lasers or stage.squares):
        raise UsageError(f"{stage.label}: lasers and squares are of records such as EXX; no recording holds one")
    true = _simulated_machine(chain, context)
    if true is None:
        direct.refuse_unstated_places(chain, single, stage.lasers)
    seen, _ = readings.of_tests(chain, tests, stage.lasers, stage.squares)
    context.progress(0.3, f"{len(chain.components)} components from {len(seen)} readings")
    modes = readings.modes(tests) if stage.modes is None else stage.modes
    identified = identify.identify(identify.Parametrisation.of(chain, modes, stage.without), seen)
    missed, largest = readings.curve_misfit(chain, seen, identified.residual)
    document = summary.document(identified, seen, missed=missed)
    document |= {"procedure": {"modes": modes, **stage.procedure()}, "unfollowed": missed}
    document["unfollowed_largest"] = largest
    if _artefacts.sign_assumed(tests.values()):
        document["sign"] = "assumed"
    if single:
        each = zip(seen.label, seen.noise, strict=True)
        noise = {records.component_of(tag): float(size * identified.noise) for tag, size in each}
        document |= {
            "reversal": records.reversals(chain, identified.setup),
            "records": _records(chain, single, stage),
            "noise_of": {n: s for n, s in noise.items() if n in chain.components},
        }
    if places := readings.squareness_uncertainty(chain, single, stage.squares, identified.errors()):
        document["places"] = places
    residual = None
    if true is not None:
        residual = residual_error.of_truth(chain, true, identified.errors())
        document["simulated_truth"] = residual.figures
    return Solved(chain, identified, document, tests, residual)


def _simulated_machine(chain: Chain, context: Context) -> MachineErrors | None:
    """The simulated machine that every test was played on; None where something was measured, or machines differ."""
    folders = context.every("simulated")
    documents = [jsonfile.read(f / _artefacts.TRUTH) for f in folders.values()]
    if not documents or len(documents) != len(context.every("recordings")):
        return None
    return residual_error.simulated_truth(chain, documents[0]) if all(d == documents[0] for d in documents) else None


def _records(chain: Chain, single: Mapping[str, Any], stage: Any) -> dict[str, dict[str, Any]]:
    """Mean reading at each target by direction, the beam's errors removed: for tables and plots."""
    out: dict[str, dict[str, Any]] = {}
    for recording in single.values():
        lasers_of_test = {n: s for n, s in stage.lasers.items() if n in recording.components()}
        for name, curve in direct.curves(recording, chain, lasers_of_test).items():
            out[name] = {
                "target": _plain(curve.position),
                "up": _plain(curve.up),
                "down": _plain(curve.down),
                "mean_error": _plain(curve.error),
            }
    return out


def _plain(values: Any) -> list[float | None]:
    return [None if v != v else round(float(v), 4) + 0.0 for v in values]


def page(solved: Solved, title: str) -> str:
    """The machine drawn, its error as vectors and slices before and after, every component, what was not seen."""
    chain, identified, document = solved.chain, solved.found, solved.document
    errors = identified.errors()
    figures = [("The machine", machine_figures.machine_sketch(chain), _component_counts(chain))]
    figures += _volumetric_figures(solved, errors)
    figures += [_component_figure(solved, errors)]
    for test in solved.tests.values():
        protocol = test.manifest.constants.get("protocol")
        if test.names("error", component="E_R") and protocol is not None and str(protocol.value) == "ballbar_circle":
            figures += ballbar_pages(test)
    data: dict[str, Any] = {
        "title": title or chain.machine.name,
        "document": document,
        "figures": figures,
        "version": __version__,
    }
    data["sign_note"] = _artefacts.SIGN_NOTE if document.get("sign") == "assumed" else ""
    data["aimed"] = residual_error.AIMED_HARM_PROBABILITY
    return render("identification.html.j2", data)


def _component_counts(chain: Chain) -> str:
    counts = {k: v for k, v in chain.counts().items() if v}
    listed = ", ".join(f"{n} {k.replace('_', ' ')}" for k, n in counts.items() if k != "total")
    return f"Drawn from its chain; arrows show each part's own motion for +. {counts['total']} components: {listed}."


def _volumetric_figures(solved: Solved, errors: MachineErrors) -> list[tuple[str, str, str]]:
    """Vectors and slices, before and after, in one scale."""
    chain, residual = solved.chain, solved.remaining
    q = residual_error.places(chain, 200)
    if residual is not None:
        before, after = residual.before(q), residual.after(q)
        sizes: dict[str, Any] = {
            n: (lambda p, f=f: np.linalg.norm(f(p), axis=1))
            for n, f in (("before", residual.before), ("after", residual.after))
        }
        caption = (
            "The machine is simulated, so its true error is known: before compensation, and what compensation by the "
            "identified components truly leaves, at places that no test measured. The workpiece's own shift and turn "
            "is taken out of both, as its datum does."
        )
    else:
        before = synthesis.first_order(chain, q, errors.at(q))[:, :3]
        spread = residual_error.spread(solved.found)
        after = spread(q)
        sizes = {"before": machine_figures.size_of(chain, errors), "after": spread}
        caption = (
            "Before: the error as identified. After: what may remain once it is compensated, the standard error of the "
            "identification. Its direction is not known; a test at positions not used here would show the residual."
        )
    figures = [("Volumetric error, before and after", machine_figures.vectors(chain, q, before, after), caption)]
    if len(chain.linear) >= 2:
        slices = machine_figures.slices(chain, sizes)
        figures.append(("Slices, before and after", slices, "Size of the error in um on the middle planes, one scale."))
    return figures


def _component_figure(solved: Solved, errors: MachineErrors) -> tuple[str, str, str]:
    bands = {}
    for name, curve in solved.document["curves"].items():
        value, half = np.array(curve["value"]), np.array(curve["half_width95"])
        at = positions_of(curve)
        bands[name] = (at, value - half, value + half)
    measured = {}
    for name, r in solved.document.get("records", {}).items():
        target, up, down = (np.array(r[key], dtype=float) for key in ("target", "up", "down"))  # None: NaN
        measured[name] = target, up, down
    caption = "After ISO 230-1: displacements left, angles right; bands are 95 % intervals."
    if measured:
        caption += " Marks: mean reading at a target coming from below (▸) and from above (◂)."
    return ("Components", machine_figures.components(errors, bands, measured), caption)
