"""Leave-one-group-out validation of an identified machine, each axis compared with no compensation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain.components import is_error_motion
from errpipe.domain.laser import Laser
from errpipe.domain.machine import Machine
from errpipe.domain.recording import Recording
from errpipe.errors import GateError
from errpipe.fitting.judging import HeldOut
from errpipe.fitting.solve import one_thread
from errpipe.fitting.statistics import rms
from errpipe.kinematics import held_out, identify, readings, residual_error, synthesis
from errpipe.kinematics.chain import Chain, compile_chain
from errpipe.kinematics.residual_error import MAX_HARM_PROBABILITY
from errpipe.models.direct import Direct

MIN_IMPROVEMENT = 0.01  # of the uncompensated rms: within this margin, no compensation is preferred
# Of the machine's expected uncompensated rms, with what no reading observes: a table that improves less is not worth
# its risk. Chosen with MIN_IMPROVEMENT of each axis on five axes by tests that do not turn the table, seeds 1 to 12
# and 401 to 410 of `trials.volumetric`: of 79 exports, 4 % better in the mean, 17 made an axis worse; of those that
# pass none. Judged on seeds 421 to 430 of it (none of 23), and of three axes on 401 to 410 (none of 268).
MIN_EXPECTED_IMPROVEMENT = 0.05


@one_thread()
def cross_validate(
    machine: Machine,
    document: Mapping[str, Any],
    tests: Mapping[str, Recording],
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> dict[str, Any]:
    """Held-out figures of each test, identified from the others: groups, and rms before and after by linear axis.

    document: the identification with its procedure; its factors reduce the compensation. Readings
    at the tool are held out by line, circle, plate or socket, records of components by run or target. A test without a
    second group is not included.
    """
    chain, procedure = compile_chain(machine), document["procedure"]
    lasers = {n: Laser(**beam) for n, beam in procedure["lasers"].items()}
    all_readings, counts = readings.of_tests(chain, tests, lasers, procedure["squares"])
    model = identify.Parametrisation.of(chain, procedure["modes"], tuple(procedure["without"]))
    factors = compensated(document, chain)
    out: dict[str, Any] = {}
    start = 0
    for name, count in counts.items():
        rows_of_test = np.arange(start, start + count)
        start += count
        number, labels = held_out.groups(chain, all_readings.take(rows_of_test))
        group = np.full(len(all_readings), -1)
        group[rows_of_test] = number
        held = held_out.cross_validate(model, all_readings, group, labels, progress, factors)
        if held:
            out[name] = _at_the_tool(chain, all_readings, held)
    for name, recording in tests.items():
        if name not in counts:
            family = _family(machine, procedure, recording)
            figures = _of_components(chain, family, recording, progress, factors)
            out |= {name: figures} if figures else {}
    return out


def compensated(document: Mapping[str, Any], chain: Chain) -> dict[str, float]:
    """Components of an identification that are compensated, with the factor by which they are (1: fully)."""
    left_alone, in_part = (document["volumetric"].get(k, {}) for k in ("left_alone", "in_part"))
    return {c: in_part.get(c, 1.0) for c in chain.components if c not in left_alone}


def _at_the_tool(chain: Chain, every: Any, left: list[held_out.HeldOutGroup]) -> dict[str, Any]:
    """Figures of readings at the tool, um."""
    rows = np.concatenate([one.rows for one in left])
    share = held_out.shares(chain, every.take(rows))
    values = {k: np.concatenate([getattr(one, k) for one in left]) for k in ("before", "after")}
    axes = {}
    for a, axis in enumerate(chain.machine.correcting_axes()):
        if share[:, a].sum() > 1e-9:
            axes[axis] = {f"rms_{k}": float(np.sqrt(share[:, a] @ v**2 / share[:, a].sum())) for k, v in values.items()}
    groups = [{"label": one.label, "rows": len(one.rows)} | _rms(one.before, one.after) for one in left]
    return {"groups": groups, "axes": axes} | _rms(**values)


def _rms(before: np.ndarray, after: np.ndarray) -> dict[str, float]:
    return _pair([rms(before), rms(after)])


def _pair(values: Sequence[float]) -> dict[str, float]:
    """rms without and with the correction, as in a document."""
    return {"rms_before": float(values[0]), "rms_after": float(values[1])}


def _family(machine: Machine, how: Mapping[str, Any], recording: Recording) -> Direct:
    motions = tuple(c for c in recording.components() if is_error_motion(c))
    lasers = {n: beam for n, beam in how["lasers"].items() if n in motions}
    return Direct(machine=machine, modes=how["modes"], components=motions, lasers=lasers)


def _of_components(
    chain: Chain, family: Direct, recording: Recording, progress: Any, factors: Mapping[str, float]
) -> dict[str, Any]:
    """Figures of records of single components: each is weighted by its mean square arm in the volume, um.

    factors: of the components that are compensated.
    """
    groups, by_component = _held_out(family, recording, progress)
    if not by_component:
        return {}
    before = {c: np.concatenate([p.before for p in parts]) for c, parts in by_component.items()}
    after = {
        c: v + factors.get(c, 0.0) * (np.concatenate([p.after for p in by_component[c]]) - v) for c, v in before.items()
    }
    squares = np.array([[np.mean(side[c] ** 2) for c in before] for side in (before, after)])  # (2, components), um2
    of_axes = _mean_square_arms(chain)[:, [chain.index(c) for c in before]] @ squares.T  # (axes, 2), um2
    axes = {x: _pair(np.sqrt(s)) for x, s in zip(chain.machine.correcting_axes(), of_axes, strict=True) if s[0] > 0.0}
    return {"groups": groups, "components": list(before), "axes": axes} | _pair(np.sqrt(of_axes.sum(axis=0)))


def _held_out(
    family: Direct, recording: Recording, progress: Any
) -> tuple[list[dict[str, Any]], dict[str, list[HeldOut]]]:
    """The groups that contain test rows, and the held-out rows of every component."""
    groups, by_component = [], dict[str, list[HeldOut]]()
    _, folds = family.folds(recording, None)
    for number, fold in enumerate(folds):
        progress(number / len(folds), f"without {fold.label}")
        parts = family.validate_fold(recording, fold)
        for component, part in parts.items():
            by_component.setdefault(component, []).append(part)
        if parts:
            groups.append({"label": fold.label, "rows": int(sum(part.rows.size for part in parts.values()))})
    return groups, by_component


def _mean_square_arms(chain: Chain) -> np.ndarray:
    """Mean square, over the volume, of the shift of each axis by 1 um (urad) of each component, (axes, components)."""
    q = residual_error.places(chain)
    to_axes = np.linalg.pinv(synthesis.linear_motion(chain, q))
    return np.mean((to_axes @ synthesis.jacobian(chain, q)[:, :3]) ** 2, axis=0)


def pass_gate(document: Mapping[str, Any], validations: list[Mapping[str, Any]]) -> tuple[str, ...]:
    """The linear axes that a table of an identification may move.

    Every axis must be expected to improve by its posterior, and must have improved on the held-out measurements.
    For an axis whose identified error is below the noise of a reading only the posterior counts; if that is
    inconclusive, the axis is not compensated. Raises GateError without a validation, or if an axis or the machine may
    get worse: axes are compensated together or not at all, because correcting one without the others rotates the whole
    part.
    """
    if not validations:
        raise GateError(
            "export: this identification was not validated on held-out measurements (add a `validate` stage "
            "after it, or set `ungated: true` to export it anyway)"
        )
    volumetric = document["volumetric"]
    axes = volumetric["axes"]
    kept = {n: a for n, a in axes.items() if a["effect_rms_um"] > document["noise_um"]}
    wrong = [] if kept else ["no axis has an identified error above the noise of a reading"]
    for name, figures in ({"the machine": volumetric} | kept).items():
        required = MIN_IMPROVEMENT if name in kept else MIN_EXPECTED_IMPROVEMENT
        if figures["probability_worse"] > MAX_HARM_PROBABILITY:
            wrong.append(_harm_sentence(name, figures))
        elif kept and figures["left_rms_um"] > (1.0 - required) * figures["before_rms_um"]:
            wrong.append(_small_gain_sentence(name, figures, required))
    for test, figures in (item for validation in validations for item in _records_together(validation).items()):
        parts = {test: figures} | {f"{n} in {test}": f for n, f in figures["axes"].items() if n in kept}
        wrong += [
            f"{name}: {part['rms_before']:.3g} -> {part['rms_after']:.3g} um on held-out measurements"
            for name, part in parts.items()
            if not part["rms_after"] < (1.0 - MIN_IMPROVEMENT) * part["rms_before"]
        ]
    if wrong:
        measures = [m["measure"] for m in document.get("would_show", ())][:3]
        advice = f" It would help to add: {'; '.join(measures)}." if measures else ""
        raise GateError(f"export: {'; '.join(wrong)}. Nothing was exported.{advice}")
    return tuple(n for n, a in axes.items() if n in kept or a["probability_worse"] <= MAX_HARM_PROBABILITY)


def _records_together(judged: Mapping[str, Any]) -> dict[str, Any]:
    """Tests to be judged: records of single components in several files count as one, because the tool sees their sum.

    A component without error or without an arm cannot improve by itself. A record that adds to the error what
    MIN_IMPROVEMENT of all records would be is judged by itself as well.
    """
    records = {name: figures for name, figures in judged.items() if "components" in figures}
    if len(records) < 2:
        return dict(judged)
    total = _sum(list(records.values()))
    harm = MIN_IMPROVEMENT * total["rms_before"] ** 2
    single = [n for n, f in records.items() if f["rms_after"] ** 2 - f["rms_before"] ** 2 <= harm]
    axes = {
        n: _sum([f["axes"][n] for f in records.values() if n in f["axes"]])
        for n in dict.fromkeys(n for f in records.values() for n in f["axes"])
    }
    return {n: f for n, f in judged.items() if n not in single} | {", ".join(records): total | {"axes": axes}}


def _sum(parts: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Root of the sum of the squares of figures of independent components."""
    return _pair([float(np.sqrt(sum(part[f"rms_{k}"] ** 2 for part in parts))) for k in ("before", "after")])


def _harm_sentence(name: str, figures: Mapping[str, float]) -> str:
    return (
        f"{name}: identified {figures['effect_rms_um']:.3g} um rms over the travel, "
        f"{figures['left_rms_um']:.3g} left open; worse with it than without with a probability of "
        f"{figures['probability_worse']:.2g} (allowed: {MAX_HARM_PROBABILITY})"
    )


def _small_gain_sentence(name: str, figures: Mapping[str, float], required: float) -> str:
    return (
        f"{name}: expected {figures['before_rms_um']:.3g} um rms without the table and {figures['left_rms_um']:.3g} "
        f"with it (required: {required:.0%} less): the tests observe too little"
    )
