"""Verification of an export: the compiled table against its error model on the recording's rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Recording
from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError, VerifyError
from errpipe.fitting.components import evaluate
from errpipe.fitting.lowering import compensable, uncompensated_terms
from errpipe.fitting.statistics import rms
from errpipe.stages.predict import table_values
from errpipe.tables import bounds
from errpipe.thermal.arithmetic import held_readings, short_gaps_held
from errpipe.validation.gate import GatedModel

ROUNDING_UM = 1e-6  # um (urad): sums in another order differ by 1e-12 of 1e5 um at most


def compare(
    table: CompensationTable, model: ErrorModel, recording: Recording, plain: CompensationTable | None = None
) -> list[dict[str, Any]]:
    """Table minus model on the recording's rows: largest and rms difference per component, um or urad.

    Both read temperatures with short gaps filled, so that values held for missing readings cause no difference.
    bound_um: what gridding and rounding may add. The table's guards may add more, where they reject a reading
    or fade outside what was seen: rows_held_back counts those rows. unguarded_difference_um: largest difference of the
    same table without its guards from the terms that it holds, with readings moved into its validity box, where its
    bound holds; beyond that, it is another model. plain: the table without a guard of its sensors; default: itself.
    """
    allowed = {c.name: c.gridding for c in bounds.components(table)}
    recording = held_readings(recording)
    by_model, by_table = evaluate(model, recording), table_values(table, model, recording)
    free, inside = _unguarded(plain or table), _within_validity(table, recording)
    held, unguarded = evaluate(compensable(model), inside), table_values(free, model, inside)
    accepted = table_values(free, model, recording)
    behind, units = uncompensated_terms(model), {c.component: c.unit for c in model.components}
    out = []
    for name, values in by_table.items():
        difference = values - by_model[name]
        known = np.isfinite(difference)
        arithmetic = np.abs(unguarded[name] - held[name])[np.isfinite(held[name])]
        out.append(
            {
                "component": name,
                "unit": units[name],
                "rows": int(known.sum()),
                "largest_difference_um": float(np.abs(difference[known]).max(initial=0.0)),
                "rms_difference_um": rms(difference[known]),
                "rms_model_um": rms(by_model[name][known]),
                "bound_um": allowed[name],
                "unguarded_difference_um": float(np.nan_to_num(arithmetic, nan=np.inf).max(initial=0.0)),
                "rows_held_back": int((np.abs(values - accepted[name])[known] > ROUNDING_UM).sum()),
                "not_compensated": behind.get(name, []),
            }
        )
    return out


def _unguarded(table: CompensationTable) -> CompensationTable:
    """The table that accepts every reading and fades nowhere."""
    free: dict[str, Any] = {"max_rate": None, "noise": 0.0, "stale_after_s": None, "valid": None, "margin": None}
    return table.model_copy(update={"inputs": tuple(i.model_copy(update=free) for i in table.inputs)})


def _within_validity(table: CompensationTable, recording: Recording) -> Recording:
    """The recording without gaps of temperatures, clipped to the validity range of the table, where its bound applies.

    In a gap of one sensor a lag of several is held as a whole, while a table holds that one input only: the two differ
    until the lag has settled, which is no error of gridding or rounding.
    """
    recording = short_gaps_held(recording, longest=None)
    boxes = {i.name: i.valid for i in table.inputs if i.valid is not None and i.name in recording}
    return recording.with_columns({n: np.clip(recording.array(n), *box) for n, box in boxes.items()}, {})


def remarks(proof: Sequence[Mapping[str, Any]], passed: GatedModel) -> list[str]:
    """Where the table's guards hold it back on its own recording, in words.

    Raises VerifyError if the table without guards differs from the model by more than its bound, and GateError
    if the guards cancel the gain of the model on held-out rows: the table may do harm.
    """
    sentences = []
    for p in proof:
        name, unit, off = p["component"], p["unit"], p["rms_difference_um"]
        if not p["unguarded_difference_um"] <= p["bound_um"] + ROUNDING_UM:
            raise VerifyError(
                f"export: {name}: the table differs from its model by {p['unguarded_difference_um']:.4g}, its bound "
                f"of gridding and rounding is {p['bound_um']:.4g} {unit}. Nothing was exported."
            )
        gains = [j["rms_before"] - j["rms_at_gain"] for j in passed.judged if j["component"] == name]
        gain = min(gains, default=p["rms_model_um"])
        words = f"{name}: on its own recording the table differs from its model by up to "
        words += f"{p['largest_difference_um']:.3g}, rms {off:.3g} {unit}"
        if p["rows_held_back"]:
            words += (
                f": it holds back in {p['rows_held_back']} of {p['rows']} rows, where readings step faster than its "
                "max_rate or lie outside what the model has seen, or where a sensor's guard replaced a reading"
            )
        if off >= gain > 0.0:
            raise GateError(f"export: {words}. The model gains {gain:.3g} {unit}. Nothing was exported.")
        if p["rows_held_back"]:
            sentences.append(words)
    return sentences
