"""A challenger fitted on the data there is now, gated against the champion; what was decided, and why, as files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from errpipe import jsonfile
from errpipe.domain.error_model import ErrorModel, joined
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, ErrpipeError, GateError, MissingColumn, UsageError, VerifyError, first_problem
from errpipe.fitting.validity import as_in_a_table, fading
from errpipe.formats.manifest_folder import MANIFEST
from errpipe.pipeline import runner
from errpipe.pipeline.graph import models_of
from errpipe.pipeline.lock import exclusive_lock
from errpipe.pipeline.spec import Pipeline
from errpipe.pipeline.step import NO_CALLBACKS, Callbacks
from errpipe.stages import _artefacts
from errpipe.validation import retraining
from errpipe.validation.retraining import RunScore
from errpipe.verbs import _retrain_drift, _retrain_gates
from errpipe.verbs._retrain_drift import predictions
from errpipe.verbs._retrain_pages import github_annotations, in_words, write_failure, write_pages

__all__ = ["github_annotations", "in_words", "retrain", "write_failure"]

VERSION = 1  # of the document's layout
MIN_RUNS_SINCE = 5  # runs since a change of the machine, from which a challenger is fitted on these alone
RUN = "run"  # folder of the challenger's pipeline run, below OUT
DOCUMENT = "retrain.json"
Limits = tuple[float | None, float | None]  # largest change of the correction, um and um/K; None for none


def retrain(
    pipeline: Pipeline,
    champion: Path,
    out: Path,
    *,
    alpha: float = 0.05,
    max_change_um: float | None = None,
    max_change_um_per_k: float | None = None,
    allowed_sensors: Sequence[str] = (),
    callbacks: Callbacks | None = None,
) -> dict[str, Any]:
    """Run the pipeline into OUT/run and decide whether its model replaces the champion's.

    champion: folder of the earlier run that made the champion (of the same pipeline). Returns the document of
    `retrain.json`: decision, evidence, gates, runs, drift. Failures to judge are on the pages, too; retrain.json
    then stays that of the look before. Raises DataError where the champion's folder lacks its
    model or recording, VerifyError where they are damaged, UsageError where the challenger would be written over it.
    """
    if champion.resolve().is_relative_to((out / RUN).resolve()):
        raise UsageError(f"{champion}: the challenger is written there, and would replace it before it is judged")
    limits, callbacks = (max_change_um, max_change_um_per_k), callbacks or NO_CALLBACKS
    with exclusive_lock(out, callbacks.waiting):  # of two at once one waits: they are one look after the other
        try:
            return _decide(pipeline, champion, out, alpha, limits, allowed_sensors, callbacks)
        except (ErrpipeError, OSError, MemoryError) as err:
            write_failure(pipeline.title, str(err) or "out of memory", out)
            raise


def _decide(
    pipeline: Pipeline, champion: Path, out: Path, alpha: float, limits: Limits, allowed: Sequence[str], how: Callbacks
) -> dict[str, Any]:
    old_model, old_recording, fingerprint = _champion(pipeline, champion)
    earlier = _earlier_document(out / DOCUMENT)
    kept_from, dates = _first_runs(earlier, fingerprint)
    cleaned = out / RUN / _last_stage_with(pipeline, "recording")
    try:
        refused, since, on_all = _run(_also_valid(pipeline, old_model, old_recording), out, dates, how)
    except MissingColumn:  # of the champion's `also_valid`: a recording of another machine
        _same_machine(champion, old_model, old_recording, _artefacts.recording_in(cleaned))
        raise
    recording = _artefacts.recording_in(cleaned)
    _same_machine(champion, old_model, old_recording, recording)
    if on_all and _no_longer_kept(dates[0], old_recording, recording):
        on_all = ""
    old, scores = (old_model, old_recording, fingerprint), _scores_of(earlier, out / DOCUMENT, fingerprint)
    document = _judged(pipeline, out, recording, old, scores, refused, alpha=alpha, limits=limits, allowed=allowed)
    document |= {"kept_from": kept_from, "fitted_since": since, "fitted_on_all": on_all}
    jsonfile.write(out / DOCUMENT, document)
    write_pages(document, out)
    return document


def _first_runs(earlier: Mapping[str, Any], champion: str) -> tuple[str | None, list[str]]:
    """The run that the champion's own fit began with (None: the first), and those that the challenger's may begin with.

    Where an earlier look at this champion dated a change of the machine, the runs before it are another machine's. It
    has to be an earlier look: runs that had a say in the date are then not those by which the challenger is judged.
    Behind the latest date stand that of the look before and the champion's own, for where too few runs follow it.
    """
    fitted, kept = earlier.get("fitted_since"), earlier.get("kept_from")
    if earlier.get("challenger") == champion:  # it was promoted
        return fitted, [fitted] if fitted else []
    if earlier.get("champion") != champion:
        return None, []
    changes = [change["since"] for change in earlier.get("drift", {}).get("changes", [])][-1:]
    return kept, [run for run in dict.fromkeys([*changes, *([fitted] if changes else []), kept]) if run]


def _run(pipeline: Pipeline, out: Path, dates: Sequence[str], callbacks: Callbacks) -> tuple[str, str | None, str]:
    """Run the pipeline on the runs since the first date with enough of them, else on all.

    Returns what refused it; since which run it is fitted; and why on all where the machine changed at a run.
    """
    by_hand = next((run for s in pipeline.stages if (run := getattr(s, "since_run", None)) is not None), None)
    reasons = []
    for since in dates if by_hand is None else ():
        stages = tuple(
            s.model_copy(update={"since_run": since}) if hasattr(s, "since_run") else s for s in pipeline.stages
        )
        try:
            runner.run(replace(pipeline, stages=stages), out / RUN, callbacks=callbacks)
            recording = _artefacts.recording_in(out / RUN / _last_stage_with(pipeline, "recording"))
            runs = len(recording.run_labels())
            if runs >= MIN_RUNS_SINCE:
                return "", since, ""
            reasons.append(f"{runs} run{'' if runs == 1 else 's'} since then, {MIN_RUNS_SINCE} needed")
        except (DataError, GateError) as err:  # too few to fit, to judge, or to be better than nothing; not kept
            reasons.append(" ".join(str(err).split()).rstrip("."))
    on_all = ""
    if reasons:
        on_all = f"The machine changed at run {dates[0]}, but the challenger is fitted on all runs: {reasons[0]}."
    try:
        runner.run(pipeline, out / RUN, callbacks=callbacks)
    except GateError as err:
        return str(err), by_hand, on_all
    return "", by_hand, on_all


def _no_longer_kept(run: str, old: Recording, new: Recording) -> bool:
    """Whether the recording no longer holds a run of the champion (earlier runs were removed): not an error."""
    labels = old.run_labels()
    return run in labels and retraining.run_contents(old)[labels.index(run)] not in retraining.run_contents(new)


def _judged(pipeline, out, recording, champion, earlier, refused, *, alpha, limits, allowed) -> dict[str, Any]:
    old_model, old_recording, fingerprint = champion
    known = retraining.runs_among(recording, retraining.run_keys(old_recording), retraining.run_contents(old_recording))
    prediction = predictions(old_model, recording)
    drift = _retrain_drift.drift(old_model, old_recording, recording, known)
    left_out = {label for stage in pipeline.stages for label in getattr(stage, "without_runs", ())}
    wrong = {o["run"] for o in drift["runs"] if o["wrong"]} | left_out
    scores = [s for s in earlier if s.run not in wrong]
    gates = [
        *_retrain_gates.responses(drift),
        *_retrain_gates.outlying_runs(drift),
        *_retrain_gates.silent_sensors(old_model, recording),
        *_retrain_gates.temperature_units(old_recording, recording, known),
    ]
    if refused:
        gates.append(retraining.Gate("pipeline", False, refused))
    else:
        folders = [out / RUN / name for name in models_of(pipeline.stages, pipeline.links, every=True)]
        model, challenger = _model_in(folders)
        lacking = [c.component for c in model.components if c.component not in prediction]
        if lacking:
            raise DataError(
                f"the champion has no {', '.join(lacking)}, which the pipeline fits: of an older pipeline? Run the"
                " pipeline into its folder anew."
            )
        already_scored = retraining.runs_among(recording, (s.key for s in scores), (s.content for s in scores))
        held, left = as_in_a_table(recording, old_model.validity)
        in_its_table = {component: left * values for component, values in predictions(old_model, held).items()}
        for family in map(_artefacts.family_in, folders):
            new = retraining.score_new_runs(recording, family, in_its_table, known, already_scored, old_model.validity)
            scores += [s for s in new if s.run not in wrong]
        gates += _retrain_gates.any_new_run(retraining.reused_names(old_recording, recording), any_new=bool(scores))
        change = _change(old_model, model, recording)
        gates += _retrain_gates.change_gate(change, limits)
        gates += [_retrain_gates.inputs(old_model, model, allowed), _retrain_gates.drifting_sensors(drift, model)]
        gates += _retrain_gates.coverage(pipeline, out / RUN)
    decision = retraining.decide(scores, gates, alpha=alpha)
    return {
        "retrain": VERSION,
        "title": pipeline.title or "Retraining",
        "champion": fingerprint,
        "challenger": "" if refused else challenger,
        "decision": "promote" if decision.promote else "keep the champion",
        "e_value": decision.e_value,
        "e_value_needed": decision.needed,
        "gates": [asdict(g) for g in decision.gates],
        "runs": [asdict(s) for s in scores],
        "drift": drift,
        "change": {} if refused else change,
        "narrower": [] if refused else _retrain_gates.narrowed_inputs(model),
    }


def _last_stage_with(pipeline: Pipeline, artefact: str) -> str:
    """Name of the last stage that gives an artefact of a type. Raises DataError where none does."""
    names = [stage.label for stage in pipeline.stages if artefact in stage.gives]
    if not names:
        raise DataError(f"{pipeline.file}: no stage gives {artefact.replace('_', ' ')}, so nothing can be retrained")
    return names[-1]


def _champion(pipeline: Pipeline, folder: Path) -> tuple[ErrorModel, Recording, str]:
    _last_stage_with(pipeline, "error_model")
    folders = [Path(folder) / name for name in models_of(pipeline.stages, pipeline.links, every=True)]
    recording = Path(folder) / _last_stage_with(pipeline, "recording")
    for path in (*(f / _artefacts.MODEL for f in folders), recording / MANIFEST):
        if not path.is_file():
            raise DataError(
                f"{folder}: no champion here ({path.relative_to(folder)} is missing; run the pipeline first)"
            )
    hint = f"(a champion of another version? Run the pipeline into {folder} anew)"
    try:
        (model, fingerprint), rows = _model_in(folders), _artefacts.recording_in(recording)
    except (DataError, VerifyError) as why:
        raise type(why)(f"{why} {hint}") from None
    try:
        predictions(model, rows.take([0]))
    except DataError as why:
        raise DataError(f"{', '.join(str(f / _artefacts.MODEL) for f in folders)}: {why} {hint}") from None
    return model, rows, fingerprint


def _model_in(folders: Sequence[Path]) -> tuple[ErrorModel, str]:
    """The model of all fits together, as it is exported, and the fingerprint of its files."""
    contents = [(folder / _artefacts.MODEL).read_bytes() for folder in folders]
    try:
        model = joined([_artefacts.read_model(folder / _artefacts.MODEL) for folder in folders])
    except (DataError, UsageError) as why:
        raise UsageError(f"{why}; to retrain them, give each a pipeline and a champion of its own") from None
    alone = contents[0] if len(contents) == 1 else "".join(map(jsonfile.fingerprint_bytes, contents)).encode()
    return model, jsonfile.fingerprint_bytes(alone)


def _same_machine(folder: Path, model: ErrorModel, old: Recording, new: Recording) -> None:
    """Raises DataError where the champion cannot be of the machine that the recording is of."""
    names = old.manifest.machine, new.manifest.machine
    if all(names) and names[0] != names[1]:
        raise DataError(f"{folder}: the champion is of machine {names[0]!r}, the recording of {names[1]!r}")
    columns = [n for n in model.columns if n not in new.frame.columns]
    responses = [c.component for c in model.components if c.component not in new.components()]
    if columns or responses:
        raise DataError(
            f"{folder}: the champion needs {', '.join([*columns, *responses])}, which the recording does not have: of"
            f" another machine, or of an older pipeline? Run the pipeline into {folder} anew."
        )


def _earlier_document(path: Path) -> Mapping[str, Any]:
    """The document of the look before; empty where there was none. Raises VerifyError where it is of another layout."""
    if not path.is_file():
        return {}
    hint = "put it back from a copy; without it the evidence of earlier looks begins anew"
    try:
        document = jsonfile.read(path)
    except VerifyError as why:
        raise VerifyError(f"{why} ({hint})") from None
    if not isinstance(document, dict) or document.get("retrain") != VERSION:
        raise VerifyError(f"{path}: not a document of retrain version {VERSION} ({hint})")
    return document


def _scores_of(document: Mapping[str, Any], path: Path, champion: str) -> list[RunScore]:
    """Scores of earlier evaluations against the same champion; a new champion begins with none."""
    if document.get("champion") != champion:
        return []
    try:
        scores = TypeAdapter(list[RunScore]).validate_python(document.get("runs"))
    except ValidationError as err:
        raise VerifyError(f"{path}: {first_problem(err, 'runs')}") from None
    for n, score in enumerate(scores):
        if not all(0.0 <= x < math.inf for x in (score.nothing, score.champion, score.challenger)):
            raise VerifyError(f"{path}: runs.{n}: a mean square is not a number of 0 um2 or more")
    return scores


def _change(old: ErrorModel, new: ErrorModel, recording: Recording) -> dict[str, dict[str, float]]:
    """Component -> how far the two models differ over the recording's rows, um, and per kelvin of any one sensor."""
    before, after = predictions(old, recording), predictions(new, recording)
    out = {}
    for component in (c for c in after if c in before):
        difference = after[component] - before[component]
        out[component] = {"largest_um": float(np.max(np.abs(difference))), "rms_um": float(np.std(difference))}
        out[component]["largest_um_per_k"] = 0.0
    later = np.diff(recording.run_codes(), prepend=-1) == 0  # from the start of a run, a constant rise is none
    for name, rise in itertools.product(recording.names("temperature"), (np.ones(len(recording)), later)):
        warmer = recording.with_columns({name: recording.array(name) + rise}, {})
        old_warm, new_warm = predictions(old, warmer), predictions(new, warmer)
        for component, figures in out.items():
            slope = (new_warm[component] - after[component]) - (old_warm[component] - before[component])
            figures["largest_um_per_k"] = max(figures["largest_um_per_k"], float(np.max(np.abs(slope))))
    return out


def _also_valid(pipeline: Pipeline, champion: ErrorModel, recording: Recording) -> Pipeline:
    """The pipeline with the champion's validity ranges, where its file states none.

    A challenger of a few runs would correct nothing in the temperatures of another season, which its terms describe.
    """
    ends = fading(champion.validity, recording)
    stages = tuple(
        s.model_copy(update={"also_valid": ends}) if getattr(s, "also_valid", None) == {} else s
        for s in pipeline.stages
    )
    return replace(pipeline, stages=stages)
