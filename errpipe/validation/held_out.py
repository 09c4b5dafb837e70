"""Figures from held-out rows: every one compared with no compensation and the noise floor.

No compensation and partial gains compete with the full model on the same rows; the smallest of them within 1 % of the
wins, if runs agree on it by more than chance (`significance`). The 90 % interval that covers a group comes from the
other groups alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout, recalibration
from errpipe.fitting.history import Fold
from errpipe.fitting.judging import HeldOut, half_width90, half_widths90_without_each, judge_components, widening90
from errpipe.fitting.noise_floor import noise_floor
from errpipe.fitting.source import Source
from errpipe.models import Family
from errpipe.validation import between_runs, clocks, seasons, significance
from errpipe.validation.steps import unexplained_steps

GAINS = (0.0, 0.25, 0.5, 0.75, 1.0)  # competing shares of a model, 0 = no compensation
# Factor on the half width from halves of one run: covers 93, 90 and 87 % of later logs after one of 1, 3 and 8 days
# (chosen on seeds 5101 and 5102 of `trials.thermal --log-days`, 12 machines; 1.0: 89, 78 and 74 %).
NEXT_RUN = 1.5
BLOCKS = "blocks:5"  # of one run, each predicted by the others
TIE_MARGIN = 0.01  # of the held-out rms: the smaller gain wins within it
VERSION = 1  # of the document's layout

Blocks = Callable[[], Mapping[str, Sequence[HeldOut]]]


def cross_validate(
    recording: Recording,
    family: Family,
    scheme: holdout.HoldOut | str | None = None,
    *,
    folds: Sequence[holdout.Fold | tuple[str, np.ndarray, np.ndarray]] | None = None,
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> tuple[dict[str, Any], dict[str, list[HeldOut]]]:
    """Refit a family without each group and validate on it: the document of `validation.json` for one scheme, and per
    component the held-out rows with their residuals.

    folds: splits made elsewhere, as (label, train mask, test mask), instead of those of `scheme`; they are refused
    if a row is both fitted and tested. rms in the response's unit. Raises DataError if nothing can be held out.
    """
    given = None if folds is None else ("given", [holdout.Fold(*fold) for fold in folds])
    label, splits = given or family.folds(recording, scheme)
    by_component, empty = _left_out(recording, family, splits, progress)

    @cache
    def blocks() -> dict[str, list[HeldOut]]:
        return _left_out(recording, family, family.folds(recording, BLOCKS)[1], progress)[0]

    document: dict[str, Any] = {
        "validation": VERSION,
        "scheme": label,
        "method": family.method_name,
        "components": [
            component_figures(
                recording,
                name,
                left,
                halves=blocks if label == holdout.HALVES else None,
                others=[other for other in by_component.values() if other is not left] if family.one_map else (),
            )
            for name, left in by_component.items()
        ],
    }
    if empty:
        document["not_judged"] = empty
    for component in document["components"]:
        component |= _disturbed(recording, component["component"], by_component[component["component"]])
    if label == holdout.HALVES:
        _of_one_run(document)
    if family.seasonal:
        tables = seasons.documents(recording, family, progress)
        if "seasons" in tables:
            _cover(document, tables["seasons"])
        document |= tables
    return document, by_component


def _disturbed(recording: Recording, name: str, folds: Sequence[HeldOut], whole: bool = True) -> dict[str, Any]:
    """What no input explains in a component. whole: no row is missing between others, as shifts in time need it."""
    shifted = clocks.shifted_runs(recording, folds) if whole else []
    steps = [] if shifted else unexplained_steps(recording, name, folds)  # a model of wrong times leaves steps, too
    return {"clocks": shifted, "steps": steps, "between_runs": between_runs.changed_from(recording, folds)}


def _left_out(
    recording: Recording, family: Family, folds: Sequence[holdout.Fold], progress: Callable[[float, str], None]
) -> tuple[dict[str, list[HeldOut]], list[str]]:
    """Per component the held-out rows of every fold, and why some folds have no test rows."""
    number = itertools.count()

    def judge(fold: holdout.Fold) -> Mapping[str, HeldOut]:
        progress(next(number) / len(folds), f"without {fold.label}")
        return family.validate_fold(recording, fold)

    return judge_components(family.responses, folds, judge)


def _of_one_run(document: dict[str, Any]) -> None:
    """Half widths for a future run; one run (or two) cannot show their coverage."""
    for component in document["components"]:
        component |= {name: NEXT_RUN * component[name] for name in ("half_width90", "half_width90_at_gain")}
        component["coverage90"] = None
        component["groups"] = [group | {"coverage90": None} for group in component["groups"]]


def cross_validate_in_batches(
    source: Source, family: Family, scheme: holdout.HoldOut | None = None
) -> tuple[dict[str, Any], dict[str, list[HeldOut]]]:
    """`cross_validate` for a recording that is read batch by batch.

    rms, mean, scatter and largest deviation are those of all rows; coverage, noise floor, steps and the test over runs
    are those of a sample of stretches of every run, which is returned second; clocks are judged if it is all rows.
    """
    done = family.validate_batches(source, scheme)
    components, rows = [], {}
    for name, folds in done.folds.items():
        sample, places = done.sample[name]
        count = sum(f.rows for f in folds)
        gains = {f"{g:g}": float(np.sqrt(sum(f.residual_at_gain(g)[0] for f in folds) / count)) for g in GAINS}
        figures = component_figures(sample, name, [f.held_out for f in folds], gains)
        groups = [g | _of_all_rows(f, w) for g, f, w in zip(figures["groups"], folds, done.worst[name], strict=True)]
        figures |= {
            "rows": count,
            "worst_group_rms_after": max(g["rms_after"] for g in groups),
            "bias": float(np.sqrt(np.mean([g["bias_after"] ** 2 for g in groups]))),
            "scatter": float(np.sqrt(np.mean([g["scatter_after"] ** 2 for g in groups]))),
            "groups": groups,
        }
        figures |= _disturbed(sample, name, [f.held_out for f in folds], whole=len(sample) == source.rows)
        figures["steps"] = [step | {"row": int(places[step["row"]])} for step in figures["steps"]]
        components.append(figures)
        rows[name] = [replace(f.held_out, rows=places[f.held_out.rows]) for f in folds]
    document = {"validation": VERSION, "scheme": done.scheme, "method": family.method_name, "components": components}
    return document, rows


def _of_all_rows(fold: Fold, worst: np.ndarray) -> dict[str, Any]:
    (before, _), (after, mean) = fold.residual_at_gain(0.0), fold.residual_at_gain(1.0)
    return {
        "rows": fold.rows,
        "rms_before": float(np.sqrt(before / fold.rows)),
        "rms_after": float(np.sqrt(after / fold.rows)),
        "worst_before": float(worst[0]),
        "worst_after": float(worst[1]),
        "bias_after": mean,
        "scatter_after": float(np.sqrt(max(after / fold.rows - mean**2, 0.0))),
    }


def _cover(document: dict[str, Any], table: Mapping[str, Any]) -> None:
    """The coverage of the model's own intervals, instead of one width derived from the other groups."""
    known = {row["left_out"]: row["coverage"] for row in table["groups"]}
    for component in document["components"]:
        for group in component["groups"]:
            group["coverage90"] = known.get(group["label"], group["coverage90"])
        covered = [g["coverage90"] for g in component["groups"] if g["coverage90"] is not None]
        if covered:
            component["coverage90"] = float(np.mean(covered))


def summarise_reasons(not_judged: Sequence[str]) -> list[str]:
    """Reasons for hold-outs without test rows, one sentence per cause: a failed sensor is not repeated every night."""
    labels: dict[str, list[str]] = {}
    for sentence in not_judged:
        label, _, why = sentence.partition(": ")
        labels.setdefault(why, []).append(label)
    ends = {why: f" to {own[-1].removeprefix('hold-out ')} ({len(own)})" for why, own in labels.items() if len(own) > 1}
    return [f"{own[0]}{ends.get(why, '')}: {why}" for why, own in labels.items()]


def component_figures(
    recording: Recording,
    component: str,
    folds: Sequence[HeldOut],
    gains: dict[str, float] | None = None,
    halves: Blocks | None = None,
    others: Sequence[Sequence[HeldOut]] = (),
) -> dict[str, Any]:
    """Figures of one component over its held-out groups. gains: rms by gain if known from further rows.

    halves: if the groups are blocks of halves that predicted each other, per component the blocks predicted by all
    others of the run; called if halves are inconclusive. others: the same groups of other components of one map, whose
    significance is tested together: each alone would be a further chance to look good.
    """
    if not folds:
        raise DataError(f"validate: no held-out rows of {component}")
    name = recording.name("error", component=component)
    half, coverage = half_width90(folds), _coverage(folds)
    gains = gains or {f"{g:g}": _pooled(folds, g) for g in GAINS}
    rows = np.concatenate([f.rows for f in folds])
    after = np.concatenate([f.after for f in folds])
    order = np.argsort(rows)
    readings = recording.array(name)[rows[order]] if name else None
    floor = noise_floor(recording, rows[order], after[order], readings)
    best = _smallest_tied_gain(gains)
    chance, runs, chosen = _tested(recording, component, folds, best, halves, others)
    figures = {
        "component": component,
        "unit": (recording.manifest.columns[name].unit if name else None) or "um",
        "rows": int(rows.size),
        "rms_before": gains["0"],
        "rms_after": gains["1"],
        "noise_floor": floor,
        "worst_group_rms_after": max(f.rms(f.after) for f in folds),
        "bias": float(np.sqrt(np.mean([np.mean(f.after) ** 2 for f in folds]))),
        "scatter": float(np.sqrt(np.mean([np.var(f.after) for f in folds]))),
        "half_width90": half,
        "coverage90": float(np.mean([c for c in coverage if c is not None])) if len(folds) > 1 else None,
        "rms_by_gain": gains,
        "gain": chosen,
        "rms_at_gain": gains[f"{chosen:g}"],
        "half_width90_at_gain": half_width90([replace(f, after=_at_gain(f, chosen)) for f in folds]),
        "p_value": chance,
        "runs": runs,
        "verdict": "do nothing" if chosen == 0.0 else ("model" if chosen == 1.0 else "partial gain"),
        "groups": [_group(f, share) for f, share in zip(folds, coverage, strict=True)],
    }
    if chosen > 0.0 and len(folds) > 1 and recalibration.is_thermal(recording):
        groups: Any = zip(*((f.rows, f.label, f.before, _at_gain(f, chosen)) for f in folds), strict=True)
        figures["readings"] = recalibration.by_readings(recording, *groups)
    return figures


def _tested(
    recording: Recording,
    component: str,
    folds: Sequence[HeldOut],
    best: float,
    halves: Blocks | None,
    others: Sequence[Sequence[HeldOut]],
) -> tuple[float, int, float]:
    """p-value of a gain, its number of observations, and the exported gain: this one or 0."""
    if halves is None:
        whole = [_joined(parts) for parts in zip(*map(_at_best_gain, (folds, *others)), strict=True)]
        chance = significance.p_value(recording, whole if others else folds, 1.0 if others else best)
        runs = significance.independent_runs(recording, folds)
    else:
        chance, runs = significance.p_between_halves(folds, best)
    chance = chance if best > 0.0 else 1.0
    if halves is None:
        return chance, runs, best if chance <= significance.LEVEL else 0.0
    if not significance.helps_between_halves(
        chance, lambda: _pooled(h := halves()[component], 1.0) / max(_pooled(h, 0.0), 1e-30)
    ):
        return chance, runs, 0.0
    return chance, runs, best if best == 1.0 else _between(folds, halves()[component])


def _at_best_gain(folds: Sequence[HeldOut]) -> list[HeldOut]:
    """The groups of a component with the residual at its best gain."""
    best = _smallest_tied_gain({f"{g:g}": _pooled(folds, g) for g in GAINS})
    return [replace(f, after=_at_gain(f, best)) for f in folds]


def _joined(parts: Sequence[HeldOut]) -> HeldOut:
    """A group of several components as one."""
    arrays = {
        name: np.concatenate([getattr(p, name) for p in parts]) for name in ("rows", "before", "after", "outside")
    }
    return HeldOut(parts[0].label, **arrays, used=sum(p.used for p in parts))


def _between(halves: Sequence[HeldOut], blocks: Sequence[HeldOut]) -> float:
    """The gain with the smallest geometric mean of the residuals of halves and of blocks of one run.

    The exported model is fitted to the whole run. A fit to a half has less information and extrapolates too
    far, a block lies between the rows that predict it: the next run is between the two.
    """
    return _smallest_tied_gain({f"{g:g}": float(np.sqrt(_pooled(halves, g) * _pooled(blocks, g))) for g in GAINS})


def _group(fold: HeldOut, coverage: float | None) -> dict[str, Any]:
    return {
        "label": fold.label,
        "rows": int(fold.rows.size),
        "rms_before": fold.rms(fold.before),
        "rms_after": fold.rms(fold.after),
        "worst_before": float(np.abs(fold.before).max()),
        "worst_after": float(np.abs(fold.after).max()),
        "bias_after": float(np.mean(fold.after)),
        "scatter_after": float(np.std(fold.after)),
        "coverage90": coverage,
        "outside_share": float(np.mean(fold.outside > 0)),
    }


def _pooled(folds: Sequence[HeldOut], gain: float) -> float:
    squares = sum(float(np.sum(_at_gain(f, gain) ** 2)) for f in folds)
    return float(np.sqrt(squares / max(sum(f.rows.size - f.used for f in folds), 1.0)))


def _at_gain(fold: HeldOut, gain: float) -> np.ndarray:
    """Residual if only a share of the correction is applied (linear between the two ends)."""
    return (1.0 - gain) * fold.before + gain * fold.after


def _smallest_tied_gain(gains: dict[str, float]) -> float:
    best = min(gains.values())
    return min(float(g) for g, rms in gains.items() if rms <= best * (1.0 + TIE_MARGIN))


def _coverage(folds: Sequence[HeldOut]) -> list[float | None]:
    """Share of each group inside the 90 % interval derived from the others; None if there is no other."""
    if len(folds) < 2:
        return [None] * len(folds)
    out: list[float | None] = []
    for k, (fold, half) in enumerate(zip(folds, half_widths90_without_each(folds), strict=True)):
        width = half + widening90([*folds[:k], *folds[k + 1 :]], half) * fold.outside
        out.append(float(np.mean(np.abs(fold.after) <= width)))
    return out
