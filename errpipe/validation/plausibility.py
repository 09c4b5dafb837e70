"""Plausibility of the declarations of a recording, tested before anything is exported.

A wrong sign, unit, column or axis fits as well as a right one, and the exported correction then doubles the error or
drives the axis into its end stop. Each check compares the declared deviation (actual minus commanded) with the range
of machine tools, and names the probable error. A finding refuses the export (`refuse`) or is only reported
(`ask`). A refusal is lifted only by name (`export: {allow: [NAME]}`), never by a general switch.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import GateError
from errpipe.validation import implausible_columns, implausible_deviations, implausible_groups
from errpipe.validation.plausibility_finding import MIN_FINITE_ROWS, Finding, responses

RESPONSE_CHECKS = (*implausible_deviations.CHECKS, *implausible_groups.CHECKS)


def findings(recording: Recording) -> list[Finding]:
    """All implausible declarations of a recording, refusals first; at most one finding per code and column."""
    results: list[Finding] = []
    for response in responses(recording):
        if response.deviation.size >= MIN_FINITE_ROWS:
            results += filter(None, (check(response) for check in RESPONSE_CHECKS))
    for check in implausible_columns.CHECKS:
        results += check(recording)
    return sorted(results, key=lambda f: (f.level != "refuse", f.column, f.code))


def refuse(findings: Iterable[Finding], allow: Sequence[str] = ()) -> list[str]:
    """Notes for the report. Raises GateError with every refusal that is not allowed by name."""
    findings = list(findings)
    refused = [f for f in findings if f.level == "refuse" and f.code not in allow]
    if refused:
        names = ", ".join(dict.fromkeys(f.code for f in refused))
        raise GateError(
            "export: refused, because the correction would follow a declaration that cannot be right:\n"
            + "\n".join(f"  {f}" for f in refused)
            + f"\nCorrect the declaration, or allow it by name where it is true: export: {{allow: [{names}]}}"
            ", or --allow NAME of `errpipe export` (errpipe explain NAME explains it). Nothing was exported."
        )
    return [f"Allowed by name: {f}" if f.level == "refuse" else f"Check: {f}" for f in findings]


# ---------------------------------------------------------------- size of the correction

LIMIT_UM = 500.0  # um (0.5 mm): a larger correction is a crash or a missing screw pitch, not an error of a machine tool
LIMIT_SHARE = 1e-3  # of the travel: error of a rack or a belt; the larger of the two limits applies
LIMIT_URAD = 1000.0  # urad (1 mm/m): the same share, as an angle


def default_limit(unit: str, travel: float | None) -> float:
    """Largest plausible correction: um from the travel in mm (None: unknown), or urad."""
    return LIMIT_URAD if unit == "urad" else max(LIMIT_UM, 1e3 * LIMIT_SHARE * (travel or 0.0))


def too_large(name: str, largest: float, unit: str, travel: float | None, limit: float | None = None) -> Finding | None:
    """The finding of a correction beyond its limit. largest: magnitude in `unit` (um or urad)."""
    allowed = default_limit(unit, travel) if limit is None else limit
    if unit not in ("um", "urad") or not np.isfinite(largest) or largest <= allowed:
        return None
    fits = [text for factor, text in SCALES if largest / factor <= allowed / 2]
    as_travel = unit == "um" and travel is not None and 0.5 < largest / (1e3 * travel) < 2.0
    meant = " or ".join(
        ["absolute readings instead of deviations,"] * (as_travel or not fits) + (fits[:1] or ["a wrong column"])
    )
    if largest < 5 * allowed:  # no unit is wrong by less than 25
        meant = "a true error that large (repair the machine, or allow it), or readings from an axis out of reference"
    basis = "set by `limit`" if limit is not None else "the larger of 0.5 mm and 1/1000 of the travel"
    basis = "1 mm/m" if limit is None and unit == "urad" else basis
    evidence = f"the correction reaches {largest:.4g} {unit}, the limit is {allowed:.4g} ({basis})"
    return Finding("beyond-limit", name, evidence, meant)


SCALES = (
    (25.4, "readings in mm that were declared as inch (25.4 times too large)"),
    (1000.0, "readings in um that were declared as mm (1000 times too large)"),
    (25400.0, "readings in um that were declared as inch (25400 times too large)"),
)


# ---------------------------------------------------------------- consequence, in one sentence


def consequence(
    axis: str, over: str, position: float, side: float, deviation: float, unit: str = "um", over_unit: str = "mm"
) -> str:
    """The controller's action at one position, as a sentence. deviation: actual minus commanded of `axis`, in `unit`.

    side: +1 approached from below, -1 from above, 0 either way.
    """
    approached = {1.0: " approached from below", -1.0: " approached from above"}.get(float(np.sign(side)), "")
    who = "the axis" if axis == over else f"the axis {axis}"
    size = f"{abs(deviation):.1f} {unit}"
    place = f"at {over} = {round(position, 9) + 0.0:.6g} {over_unit}{approached}"
    if f"{abs(deviation):.1f}" == "0.0":
        return f"{place} {who} stands where it should and is left alone"
    if deviation > 0:
        return f"{place} {who} stands {size} too far and will be commanded {size} less"
    return f"{place} {who} stands {size} short and will be commanded {size} further"
