"""What `init` adds to a static model where heat helps: terms of temperatures, each only if held-out groups want it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from errpipe import yamlfile
from errpipe.cleaning import clean
from errpipe.domain.manifest_text import flow, scalar
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.statistics import student_tail
from errpipe.models import DEFAULT, FAMILIES
from errpipe.validation import significance

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording
    from errpipe.fitting.holdout import HoldOut
    from errpipe.fitting.judging import HeldOut
    from errpipe.models import Family

WARM, HEAT = "@WARM@", "@HEAT@ "
MIN_TEMPERATURE_CHANGE = 1.0  # K between medians of runs: several times a sensor's noise and calibration error
MIN_GROUPS = 3  # groups; two cannot tell heat from whatever else differs between them
MIN_IMPROVEMENT = 0.05  # share of the held-out rms that a step must take away (by judgement)
MAX_FOLDS = 12  # more cost time: three dozen models are judged
MIN_READ_SHARE = 0.9  # share of the rows of every group in which a temperature that is proposed was read
TIE_MARGIN = 0.01  # of the held-out rms: fewer terms win within it
MAX_ROWS = 6000  # judged: rows of a run resemble each other, and a laser test has fewer


@dataclass(frozen=True)
class Heat:
    """scheme: groups that were held out; terms: numbers of the candidates that help; before, after: held-out rms."""

    scheme: HoldOut
    terms: tuple[int, ...]
    before: float
    after: float


def proposed(text: str, recording: Recording | None) -> tuple[str, list[str]]:
    """A pipeline whose lines with WARM are candidates and whose line with HEAT takes the place of the one before it.

    The text with the candidates that help, each with its sensor, and one sentence that says why; without all of these
    lines where none helps.
    """
    lines = text.splitlines()
    candidates = [line for line in lines if WARM in line]
    cleaned = None
    if candidates and recording is not None and changing_temperatures(recording):
        with suppress(DataError):  # no candidate is a sensor that cleaning excludes
            cleaned = clean(recording)[0]
    sensors = changing_temperatures(cleaned) if cleaned is not None else []
    filled = [line.replace(WARM, scalar(name)) for line in candidates for name in sensors]
    steps: list[tuple[int, ...]] = [(k,) for k in range(len(filled))]
    steps += [tuple(range(k, len(filled), len(sensors))) for k in range(len(sensors))]  # all terms of one sensor
    scheme = scheme_of(cleaned) if cleaned is not None and filled else None

    def written(chosen: Sequence[int]) -> str:
        out: list[str] = []
        for line in lines:
            if WARM in line:
                out += [filled[k] for k in chosen] if line is candidates[0] else []
            elif HEAT not in line:
                out.append(line)
            elif chosen:
                out[-1] = line.replace(HEAT, "")
        return "\n".join([*out, ""])

    def family(chosen: Sequence[int]) -> Family:
        return family_of(written(chosen))

    heat = (
        cleaned is not None and scheme is not None and forward_selection(cleaned, scheme, family, steps, len(sensors))
    )
    if not heat:
        return written(()), []
    what = holdout.name(heat.scheme)
    why = f"terms of heat: {what} leaves {heat.after:.3g} um with them, {heat.before:.3g} um without temperatures"
    text = f"{flow(heat.scheme.model_dump(exclude_defaults=True))}   # {why}"
    return re.sub(r"(?m)^( +holdout: ).*", lambda found: found[1] + text, written(heat.terms)), [why]


def family_of(text: str) -> Family:
    """The model that the stage `fit` of a pipeline names."""
    entry = next(s for s in yamlfile.parse(text).value["stages"] if s["kind"] == "fit")
    del entry["kind"]
    made: Family = FAMILIES[DEFAULT].model_validate(entry)
    return made


def changing_temperatures(recording: Recording) -> list[str]:
    """Temperatures whose medians of runs differ by more than MIN_TEMPERATURE_CHANGE, in manifest order."""
    run, out = recording.run_codes(), []
    for name in recording.names("temperature"):
        values = recording.array(name)
        medians = [np.median(v) for code in np.unique(run) if (v := values[(run == code) & np.isfinite(values)]).size]
        if len(medians) >= MIN_GROUPS and np.ptp(medians) > MIN_TEMPERATURE_CHANGE:
            out.append(name)
    return out


def scheme_of(recording: Recording) -> HoldOut | None:
    """Whole groups to hold out: the coarsest of MIN_GROUPS or more (seasons, days), else runs; else None."""
    dated = recording
    with suppress(DataError):  # no dates
        dated = holdout.with_calendar(recording, "day")
    run, known = recording.run_codes(), {}
    for column in dated.names("group"):
        of = dated.manifest.columns[column].of or column
        label = np.unique(holdout.labels(dated, of), return_inverse=True)[1]
        count = np.unique(label).size
        if count >= MIN_GROUPS and np.unique(np.stack([run, label]), axis=1).shape[1] == np.unique(run).size:
            known[of] = count
    coarsest = min(known, key=lambda name: known[name]) if known else None
    count = known[coarsest] if coarsest else np.unique(run).size
    if count < MIN_GROUPS:
        return None
    if count > MAX_FOLDS:
        return holdout.HoldOut(scheme="batches", of=coarsest, blocks=MAX_FOLDS)
    return holdout.HoldOut(scheme="leave-one-group-out" if coarsest else "leave-one-run-out", of=coarsest)


def forward_selection(
    recording: Recording,
    scheme: HoldOut,
    family: Callable[[Sequence[int]], Family],
    steps: Sequence[tuple[int, ...]],
    sensors: int,
) -> Heat | None:
    """The candidates that held-out groups want beside the static model, step by step; None where none is wanted.

    family: the model with the candidates of these numbers; steps: candidates that may be added together, of `sensors`
    temperatures. Each step must reduce the held-out rms by MIN_IMPROVEMENT, and by more than chance (`_chance`), shared
    among the temperatures.
    """
    recording = recording.take(np.arange(len(recording)) % -(-len(recording) // MAX_ROWS) == 0)
    chosen: tuple[int, ...] = ()
    first = judged = held_out_residuals(recording, scheme, family(chosen))
    while judged is not None:
        wider = {tuple(sorted({*chosen, *step})) for step in steps} - {chosen}
        tried = {terms: held_out_residuals(recording, scheme, family(terms)) for terms in sorted(wider)}
        able = {terms: left for terms, left in tried.items() if left is not None and _on_same_rows(judged, left)}
        able = {terms: left for terms, left in able.items() if rms(left) <= (1.0 - MIN_IMPROVEMENT) * rms(judged)}
        while able and not _identifiable(recording, family(_best(able))):
            del able[_best(able)]
        if not able:
            break
        terms = _best(able)
        runs = significance.independent_runs(recording, judged)
        if _chance(rms(judged), rms(able[terms]), runs, len(terms)) > significance.LEVEL / sensors:
            break
        judged, chosen = able[terms], terms
    return Heat(scheme, chosen, rms(first), rms(judged)) if first and judged and chosen else None


def _chance(before: float, after: float, runs: int, terms: int) -> float:
    """One-sided p of the share of the held-out mean square that is explained, as that of a correlation over runs.

    A paired test over runs asks each of them for a gain, and a run at the mean temperature has none. 60 machines whose
    heat no sensor sees, 3 sensors: 0 of 60 with 3 runs a season get terms of heat, 1 of 60 with 6 (seeds 100 to 159).
    """
    degrees, left = runs - 1 - terms, (after / before) ** 2
    return student_tail(np.sqrt((1.0 - left) * degrees / max(left, 1e-12)), degrees) if degrees > 0 else 1.0


def held_out_residuals(recording: Recording, scheme: HoldOut, family: Family) -> list[HeldOut] | None:
    """Residuals of every held-out group; None where the model cannot be fitted without one of them."""
    try:
        dated = holdout.with_calendar(recording, scheme.of)
        folds = holdout.groups(dated, scheme)
        return [left for fold in folds for left in family.validate_fold(dated, fold).values()]
    except DataError:
        return None


def _identifiable(recording: Recording, family: Family) -> bool:
    """Whether the fit on all rows is not refused, such as for two sensors that rise together."""
    try:
        family.fit(recording)
    except DataError:
        return False
    return True


def _best(able: Mapping[tuple[int, ...], Sequence[HeldOut]]) -> tuple[int, ...]:
    """The fewest terms within TIE_MARGIN of the least held-out rms."""
    best = min(map(rms, able.values()))
    return min((terms for terms, left in able.items() if rms(left) <= (1.0 + TIE_MARGIN) * best), key=len)


def _on_same_rows(without: Sequence[HeldOut], extended: Sequence[HeldOut]) -> bool:
    """Whether more terms are judged on the same rows, but for the few where a temperature is missing."""
    return len(without) == len(extended) and all(
        h.rows.size > MIN_READ_SHARE * w.rows.size for w, h in zip(without, extended, strict=True)
    )


def rms(folds: Sequence[HeldOut]) -> float:
    """Root mean square over groups, in the response's unit."""
    return float(np.sqrt(np.mean([f.rms(f.after) ** 2 for f in folds])))
