"""Gates of a promotion: conditions on a challenger in addition to its evidence, each with its reason."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from errpipe import jsonfile
from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Recording
from errpipe.pipeline.spec import Pipeline
from errpipe.stages import _artefacts
from errpipe.validation import input_drift
from errpipe.validation.held_out import summarise_reasons
from errpipe.validation.retraining import MIN_COVERAGE, Gate
from errpipe.verbs._retrain_drift import runs_without_readings, with_new_runs

MAX_NAMED = 6  # runs that a gate names


def drifting_sensors(drift: Mapping[str, Any], model: ErrorModel) -> Gate:
    """No promotion of a challenger that reads a sensor which may drift: the drift was part of its training data."""
    faulty = [d["column"] for d in drift["inputs"] if d["flagged"]]
    if not set(faulty) & set(model.columns):
        return Gate("sensors", True, "no sensor of the challenger drifts")
    return Gate("sensors", False, f"{input_drift.drifting_sensors(faulty)}; repair or replace it first")


def responses(drift: Mapping[str, Any]) -> Iterator[Gate]:
    """No promotion of a challenger fitted on responses that are no deviations of the uncompensated machine."""
    for d in (d for d in drift["sizes"] if d["meaning"]):
        says = f"since run {d['since']} they are {d['factor']:.2g} times what the champion predicts: {d['meaning']}"
        yield Gate(f"readings of {d['component']}", False, says)


def outlying_runs(drift: Mapping[str, Any]) -> Iterator[Gate]:
    """No promotion of a challenger fitted on single runs whose readings are known to be wrong."""
    runs: dict[tuple[str, str], list[str]] = {}
    for outlier in (o for o in drift["runs"] if o["wrong"]):
        runs.setdefault((outlier["what"], outlier["says"]), []).append(outlier["run"])
    for (what, says), labels in runs.items():
        remedy = "put right, or left out (`without_runs` of ingest)"
        yield Gate(f"readings of {what}", False, f"in run {', '.join(labels)} {says}: {remedy}")


def silent_sensors(model: ErrorModel, recording: Recording) -> Iterator[Gate]:
    """Runs without evidence, as a sensor was silent; no promotion of a model with a sensor that is still silent."""
    last = recording.run_labels()[-1]
    for name, runs in runs_without_readings(model, recording).items():
        more = " and earlier ones" if len(runs) > MAX_NAMED else ""
        says = f"none in run {', '.join(runs[-MAX_NAMED:])}{more}: no evidence"
        says += ", and none in the last run: repair it, or fit without it" if last in runs else ""
        yield Gate(f"readings of {name}", last not in runs, says)


def temperature_units(old: Recording, recording: Recording, known: frozenset[str]) -> list[Gate]:
    """No promotion of a challenger whose new temperatures are in another unit: the controller's are not."""
    both, reference = with_new_runs(old, recording, known)
    found = None if both is None else input_drift.other_unit(both, reference)
    if found is None:
        return []
    return [Gate("temperatures", False, f"since run {found[1]} all of them read as if in {found[0]}")]


def any_new_run(reused: Sequence[str], any_new: bool) -> list[Gate]:
    """New readings under the name of a run that fitted the champion count as old: fails where no run is new."""
    if not reused:
        return []
    says = (
        f"{', '.join(reused[:MAX_NAMED])}{', ...' if len(reused) > MAX_NAMED else ''}: called as runs that fitted the"
        " champion, with other readings, and counted as these: give new runs names of their own, or a time with a date"
    )
    return [Gate("names of runs", any_new, says)]


def change_gate(
    differences: Mapping[str, Mapping[str, float]], limits: tuple[float | None, float | None]
) -> Iterator[Gate]:
    """No promotion of a challenger that differs from the champion by more than is allowed.

    differences: component -> largest difference, um, and per kelvin of a sensor, um/K; limits: of these, None for none.
    """
    for component, figures in differences.items():
        for key, unit, limit in zip(("largest_um", "largest_um_per_k"), ("um", "um/K"), limits, strict=True):
            name = f"change of {component}{' per kelvin' if unit == 'um/K' else ''}"
            allowed = "" if limit is None else f" ({limit:g} {unit} allowed)"
            yield Gate(name, limit is None or figures[key] <= limit, f"at most {figures[key]:.3g} {unit}{allowed}")


def narrowed_inputs(model: ErrorModel) -> list[str]:
    """Inputs of which the challenger is fitted on a part of the range that it holds for, a sentence each."""
    out = []
    for name, (low, high) in model.validity.seen.items():
        unit = model.columns.get(name, {}).get("unit") or ""
        lowest, highest = model.validity.ranges[name]
        out.append(
            f"{name}: the challenger is fitted from {low:.4g} to {high:.4g} {unit}, and corrects from {lowest:.4g} to"
            f" {highest:.4g} {unit}, as the champion does."
        )
    return out


def inputs(old: ErrorModel, new: ErrorModel, allowed: Sequence[str]) -> Gate:
    """No promotion of a challenger that requires a column which the champion does not, unless it is allowed."""
    added = sorted(set(new.columns) - set(old.columns) - set(allowed))
    says = f"newly required: {', '.join(added)} (--allow-sensor, once the controller reads it)" if added else ""
    return Gate("inputs", not added, says or "no column is newly required")


def coverage(pipeline: Pipeline, folder: Path) -> list[Gate]:
    """No promotion of a challenger whose 90 % interval does not cover held-out rows. folder: of its run."""
    names = [stage.label for stage in pipeline.stages if "validation" in stage.gives]
    if not names:
        return [Gate("validation", False, "the pipeline has no validate stage, so its held-out figures are unknown")]
    read = [jsonfile.read(folder / name / _artefacts.VALIDATION) for name in names]
    out = [Gate("held-out runs", True, why) for v in read for why in summarise_reasons(v.get("not_judged", ()))]
    for component in {c["component"]: c for v in read for c in v["components"]}.values():
        covered = component["coverage90"]
        name = f"coverage of {component['component']}"
        if covered is None:
            out.append(Gate(name, True, "unknown: one group only"))
        else:
            says = f"{covered:.2f} of held-out rows in the 90 % interval, {MIN_COVERAGE:g} needed"
            out.append(Gate(name, covered >= MIN_COVERAGE, says))
    return out
