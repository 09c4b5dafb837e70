"""The findings of a diagnosis put into the simulation: a corrected recording, terms, and a patch to add to it.

recording.yaml, .parquet   the recording, its simulated columns with what was missing
terms.yaml                 the findings as terms with their parameters fixed, for `components:` of a fit stage
patch.py, patch.fmu        the machine's findings as equations: numpy functions, and an FMU (FMI 2.0, co-simulation)
parameters.yaml            tunable parameters of the simulating FMU as they were set right, where it is one
apply.json                 what was put in, what was not and why, and what a second diagnosis still finds
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from errpipe import jsonfile
from errpipe.diagnosis import applied, diagnose
from errpipe.diagnosis.applied import GAIN, Corrected, Held, Part
from errpipe.domain.diagnosis import Diagnosis
from errpipe.domain.manifest_text import flow
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import in_order_of_time
from errpipe.formats import manifest_folder
from errpipe.simulation import patch, patch_fmu
from errpipe.simulation.patch import Piece, value
from errpipe.stages._docstrings import equation
from errpipe.terms import plain

DOCUMENT = "apply.json"
MIN_CONFIDENCE = 0.8  # as for a term of the error model (option `accept` of the stage)
SAME = 0.02  # of a finding's largest value: largest difference allowed between its equation in the patch and its term
OF_MEASURING = "an artefact of measuring: in the corrected recording, not in the patch of the machine's simulation"
IN_SOME_RUNS = "it acted in some runs only: no equation predicts in which runs it will act"
NO_EQUATION = "its term cannot be written as an equation of the inputs of a simulation"

EMPIRICAL = "an empirical equation"

Progress = Callable[[float, str], None]


def apply_findings(
    recording: Recording,
    diagnosis: Diagnosis,
    out: Path,
    held: Sequence[Held] | None = None,
    parameters: Sequence[Mapping[str, Any]] = (),
    progress: Progress = lambda share, text: None,
) -> dict[str, Any]:
    """Write the corrected simulation into the folder `out`; the document of apply.json. Raises DataError.

    recording: with its simulated columns; held: of each response what its simulated signal was found to be a sum of
    (see `diagnosis.applied`); parameters: of a simulating FMU, as they were set right.
    """
    recording = in_order_of_time(recording)
    results = applied.corrected(recording, diagnosis, MIN_CONFIDENCE, held)
    frame = recording.frame.assign(**{c.column: c.simulated for c in results})
    corrected = Recording(recording.manifest, frame, recording.between)
    read = applied.causal(recording)
    pieces, why_not = _patch_equations(results, read)
    manifest_folder.write(corrected, out)
    jsonfile.write_text(out / "terms.yaml", terms_text(results))
    problem = _write_patch(out, results, pieces, read)
    if parameters:
        lines = [f"{p['parameter']}: {p['value']:.12g}  # was {p['start']:.12g}" for p in parameters]
        jsonfile.write_text(out / "parameters.yaml", "\n".join(lines) + "\n")
    second, _ = diagnose(corrected, progress)
    document = {
        "apply": 1,
        "responses": [_response_document(c, why_not) for c in results],
        "fmu": problem or "patch.fmu" if pieces else "nothing to add",
        "second_diagnosis": {
            r.component: {
                "verdict": r.verdict,
                "rms_um": r.rms_before_um,
                "findings": [f.effect for f in r.findings],
                "says": r.says,
            }
            for r in second.responses
        },
    }
    jsonfile.write(out / DOCUMENT, document)
    return document


def in_words(document: Mapping[str, Any]) -> list[str]:
    """What was added and the residual, one line each."""
    lines = []
    for r in document["responses"]:
        words = (EMPIRICAL if p["effect"] == "unknown" else p["effect"].replace("_", " ") for p in r["put_in"])
        names = ", ".join(words) or "nothing"
        before, after = r["rms_before_um"], r["rms_after_um"]
        lines.append(f"{r['component']}: added to the simulation: {names}; {before:.3g} -> {after:.3g} {r['unit']} rms")
        lines += [f"  not added: {n['effect'].replace('_', ' ')} ({n['reason']})" for n in r["not_put_in"]]
        lines += [
            f"  not in the patch: {p['effect'].replace('_', ' ')} ({p['not_in_patch']})"
            for p in r["put_in"]
            if p["not_in_patch"]
        ]
        lines.append(f"  diagnosed again: {document['second_diagnosis'][r['component']]['says']}")
    return lines


def _response_document(c: Corrected, why_not: Mapping[tuple[str, str], str]) -> dict[str, Any]:
    before, after = c.mismatch, c.left
    return {
        "component": c.component,
        "unit": c.unit,
        "simulated": c.column,
        "gain": c.gain,
        "offset_um": c.offset,
        "rms_before_um": float(np.sqrt(np.nanmean(before**2))),
        "rms_after_um": float(np.sqrt(np.nanmean(after**2))),
        "put_in": [
            {
                "effect": p.finding.effect,
                "terms": [t.term for t in p.terms],
                "of_measuring": p.of_measuring,
                "parameters": [dict(v) for v in p.values],
                "rms_um": float(np.nanstd(p.contribution)),
                "not_in_patch": why_not.get((c.component, p.finding.effect), ""),
            }
            for p in c.parts
        ],
        "not_put_in": [{"effect": effect, "reason": reason} for effect, reason in c.refused],
    }


def terms_text(done: Sequence[Corrected]) -> str:
    """The accepted findings as YAML 1.2: `components` of a fit stage, every parameter fixed."""
    lines = [
        "# Effects missing from the simulation, for `components:` of a fit stage; remove `fixed` to refit a parameter."
    ]
    rows = []
    for c in done:
        terms = []
        for part in c.parts:
            where = part.finding.where.plain()
            note = f"  # acts in {flow(where)} only" if where else ""
            note += (
                "  # corrects the gain of an effect that the simulation includes" if part.finding.effect == GAIN else ""
            )
            for term, values in zip(part.terms, part.values, strict=True):
                terms.append(f"      - {flow(plain(term) | {'fixed': values})}{note}")
        if (c.gain, c.offset) != (1.0, 0.0):
            lines.append(
                f"# {c.component}: first {c.gain:.6g} times the simulated deviation, plus {c.offset:.6g} {c.unit}."
            )
        if terms:
            rows += [f"  - component: {c.component}", "    terms:", *terms]
    return "\n".join([*lines, "components:", *rows] if rows else [*lines, "components: []"]) + "\n"


# ---------------------------------------------------------------- the patch


def _patch_equations(
    done: Sequence[Corrected], read: Recording
) -> tuple[tuple[Piece, ...], dict[tuple[str, str], str]]:
    """Equations of the machine's findings; (component, effect) -> why one is not among them."""
    pieces, why_not = [], {}
    for c in done:
        for part in c.parts:
            made = _piece(c, part, read)
            if isinstance(made, str):
                why_not[c.component, part.finding.effect] = made
            else:
                pieces.append(made)
    twice = [p.name for p in pieces]
    numbered = [f"{n}_{twice[: k + 1].count(n)}" if twice.count(n) > 1 else n for k, n in enumerate(twice)]
    return tuple(replace(p, name=n) for p, n in zip(pieces, numbered, strict=True)), why_not


def _piece(c: Corrected, part: Part, read: Recording) -> Piece | str:
    """One finding's equations, or why there are none."""
    f = part.finding
    effect = f"gain_of_{part.terms[0].term}" if f.effect == GAIN else f.effect
    if part.of_measuring and f.effect != GAIN:
        return OF_MEASURING
    if f.where.runs:
        return IN_SOME_RUNS
    pairs = [t.equation(v) for t, v in zip(part.terms, part.values, strict=True)]
    if any(p is None for p in pairs):
        return NO_EQUATION
    all_pairs = tuple(pair for p in pairs for pair in p or ())
    numbers = [f"{n} = {v:.6g}" for values in part.values for n, v in values.items()]
    equations = dict.fromkeys(e for t in part.terms if (e := equation(type(t))))
    if f.empirical is not None:
        equations = dict.fromkeys(f"gain times {t.column}" for t in f.empirical.terms)
    note = ". ".join([f"{effect.replace('_', ' ')} of {c.component} in {c.unit}: {', '.join(numbers)}", *equations])
    name = "".join(ch if ch.isalnum() else "_" for ch in f"{c.component}_{effect}")
    piece = Piece(name, c.component, c.unit, note, all_pairs, dict(f.where.ranges))
    off = np.nanmax(np.abs(value(piece, read) - part.contribution))
    return piece if off <= SAME * np.nanmax(np.abs(part.contribution)) else NO_EQUATION


def _write_patch(out: Path, done: Sequence[Corrected], pieces: tuple[Piece, ...], read: Recording) -> str:
    """patch.py and patch.fmu, where there is something to put in; why the FMU cannot run, '' where it can."""
    gains = {c.component: (c.gain, c.offset) for c in done if (c.gain, c.offset) != (1.0, 0.0)}
    if pieces or gains:
        text = patch.python_module(pieces, read, read.manifest.title or "what the simulation lacks", gains)
        jsonfile.write_text(out / "patch.py", text)
    if not pieces:
        return ""
    data, problem = patch_fmu.build(pieces, read)
    jsonfile.write_bytes(out / "patch.fmu", data)
    return problem
