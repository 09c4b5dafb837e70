"""Compare a recording with its simulation: missing effects are located, named, modelled and validated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from errpipe import __version__, jsonfile
from errpipe.diagnosis import against as earlier_findings
from errpipe.diagnosis import diagnose as judge
from errpipe.diagnosis.derived import with_responses
from errpipe.domain.diagnosis import Diagnosis
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, UsageError, VerifyError, first_problem
from errpipe.formats import manifest_folder
from errpipe.formats.manifest_folder import MANIFEST
from errpipe.reporting.diagnosis_report import Trace, render
from errpipe.simulation import external
from errpipe.stages import _apply_findings, _artefacts
from errpipe.stages._docstrings import equation
from errpipe.terms import TERMS

ROWS = 20  # with fewer rows no warning is given
MIN_CORRELATION = 0.8  # correlation from which on the two are one curve
MIRRORED = (0.8, 1.25)  # minus the slope of measured on simulated of a sign alone; missing physics gives any slope
UNIT = 300.0  # factor between the two from which on a unit is likelier than a simulation so far off (um and mm: 1000)


def diagnose(
    recording: Path,
    out: Path,
    progress: Callable[[float, str], None] = lambda share, text: None,
    simulation: Path | None = None,
    apply: Path | None = None,
) -> dict[str, Any]:
    """Diagnose a recording folder into `out`: diagnosis.json and report.html.

    simulation: if the recording has no simulated columns: a CSV, an error model (.json) or an FMU.
    apply: folder for the corrected simulation (see `stages._apply_findings`).
    Raises UsageError, with one clear message, for input that cannot be used.
    """
    if apply is not None and Path(apply).resolve() in (Path(recording).resolve(), Path(out).resolve()):
        raise UsageError(f"--apply {apply}: name a folder other than those of the recording and of the diagnosis")
    if (
        apply is not None
        and (Path(apply) / MANIFEST).exists()
        and not (Path(apply) / _apply_findings.DOCUMENT).exists()
    ):
        raise UsageError(
            f"--apply {apply}: contains a recording that is not a corrected simulation: name another folder"
        )
    half = 1.0 if apply is None else 0.5
    try:
        read, notes, parameters = with_simulation(manifest_folder.read(Path(recording)), simulation)
        document, page, diagnosis, held = diagnose_recording(
            read, lambda share, text: progress(half * share, text), notes
        )
    except DataError as err:
        raise UsageError(str(err)) from None
    jsonfile.write(Path(out) / "diagnosis.json", document)
    jsonfile.write_text(Path(out) / "report.html", page)
    lines = [*sign_and_unit_warnings(read), *(r.says for r in diagnosis.responses)]
    summary = {"says": lines, "verdicts": {r.component: r.verdict for r in diagnosis.responses}}
    if apply is not None:

        def later(share: float, text: str) -> None:
            progress(0.5 + 0.5 * share, f"once more: {text}")

        applied = _apply_findings.apply_findings(read, diagnosis, Path(apply), held, parameters, later)
        lines += [*_apply_findings.in_words(applied), *(str(f) for f in sorted(Path(apply).iterdir()))]
        summary |= {"apply": applied}
    elif any(r.verdict == "missing_physics" for r in diagnosis.responses):
        lines.append(
            "--apply DIR writes the simulation with the missing physics added: recording, terms, patch.py, patch.fmu"
        )
    lines.append(str(Path(out) / "report.html"))
    return summary


def against(recording: Path, findings: Path, out: Path, simulation: Path | None = None) -> dict[str, Any]:
    """Look for the findings of an earlier diagnosis.json in a later recording; writes against.json into `out`.

    Returns lines to print, and `changed`: the effects that changed. Raises UsageError for input that
    cannot be used, VerifyError where `findings` is no diagnosis.
    """
    if not Path(findings).is_file():
        raise UsageError(f"--against {findings}: there is no such file (the diagnosis.json of an earlier diagnosis)")
    try:
        earlier = Diagnosis.model_validate(jsonfile.read(Path(findings)))
    except ValidationError as err:
        raise VerifyError(f"{findings}: not a diagnosis: {first_problem(err)}") from None
    try:
        read, _, _ = with_simulation(manifest_folder.read(Path(recording)), simulation)
        held = earlier_findings.against(read, earlier)
    except DataError as err:
        raise UsageError(str(err)) from None
    document = {"against": 1, "findings": [h.plain() for h in held]}
    jsonfile.write(Path(out) / "against.json", document)
    changed = [f"{h.effect} ({h.component})" for h in held if h.changed]
    return {
        "says": [*sign_and_unit_warnings(read), *(h.says for h in held), *earlier_findings.larger_residuals(held)],
        "changed": changed,
        **document,
    }


def diagnose_recording(
    recording: Recording, progress: Callable[[float, str], None], notes: tuple[str, ...] = ()
) -> tuple[dict[str, Any], str, Diagnosis, list[Any]]:
    """diagnosis.json as plain data, the page, the findings, and what each simulated signal is a sum of.

    notes: reported before all else.
    """
    diagnosis, rows = judge(recording, progress)
    diagnosis = diagnosis.model_copy(update={"notes": (*sign_and_unit_warnings(recording), *notes, *diagnosis.notes)})
    clock = recording.name("time") or ""
    units = {name: c.unit for name, c in recording.manifest.columns.items() if c.unit}
    traces = [Trace(r.before, r.after, r.run, r.contribution, r.inputs, clock, units) for r in rows]
    terms = {str(t["term"]) for r in diagnosis.responses for f in r.findings for t in f.all_terms()}
    equations = {name: equation(TERMS[name]) for name in sorted(terms)}
    page = render(diagnosis, traces, machine=recording.manifest.machine, version=__version__, equations=equations)
    return diagnosis.document(), page, diagnosis, [r.simulated_parts for r in rows]


def with_simulation(
    recording: Recording, simulation: Path | None
) -> tuple[Recording, tuple[str, ...], list[dict[str, Any]]]:
    """The recording with a simulation from a file, notes, and parameters: .csv, .json (an error model) or .fmu.

    Tunable parameters of an FMU are calibrated on the recording first, so that no effect is named for their errors.
    """
    recording = with_responses(recording)
    if simulation is None:
        return recording, (), []
    file = Path(simulation)
    model = _artefacts.read_model(file) if file.suffix.lower() == ".json" else None
    read, twins, figures = external.with_twins(recording, external.by_name(recording, file), file, model)
    notes = [f"{t.component}: {note}" for t in twins for note in t.notes]
    notes += [
        f"{file.name}: {p['parameter']} recalibrated before missing physics was searched for: {p['start']:g} -> "
        f"{p['value']:.4g} (allowed: {p['low']:g} to {p['high']:g})"
        for p in figures.get("parameters", ())
        if p["value"] != p["start"]
    ]
    return read, tuple(notes), list(figures.get("parameters", ()))


def sign_and_unit_warnings(recording: Recording) -> tuple[str, ...]:
    """A sentence for each response whose simulated column seems to have another sign or unit.

    Slope and correlation are over all rows with both.
    """
    out = []
    for component in recording.components():
        names = [recording.name(role, component=component) for role in ("error", "simulated")]
        if None in names:
            continue
        measured, simulated = (recording.array(str(name)) for name in names)
        both = np.isfinite(measured) & np.isfinite(simulated)
        y, s = measured[both], simulated[both]
        if y.size < ROWS or not (np.std(y) > 0.0 and np.std(s) > 0.0):
            continue
        correlation = float(np.corrcoef(y, s)[0, 1])
        slope = correlation * float(np.std(y) / np.std(s))
        if correlation < -MIN_CORRELATION and MIRRORED[0] < -slope < MIRRORED[1]:
            why = "one of them has the other sign (deviation = actual - commanded)"
        elif abs(correlation) > MIN_CORRELATION and not 1.0 / UNIT < abs(slope) < UNIT:
            unit = recording.manifest.columns[str(names[1])].unit
            why = f"one of them is probably not in {unit}"
        else:
            continue
        out.append(f"{component}: measured is {slope:.3g} of simulated (correlation {correlation:.2f}): {why}")
    return tuple(out)
