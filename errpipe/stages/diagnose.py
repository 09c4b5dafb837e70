"""A recording beside its simulation in; what the simulation leaves out, located, named, modelled and proved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from errpipe.domain.diagnosis import Diagnosis
    from errpipe.domain.recording import Recording


def diagnose(
    recording: Path,
    out: Path,
    progress: Callable[[float, str], None] = lambda share, text: None,
    simulation: Path | None = None,
) -> dict[str, Any]:
    """Diagnose a recording folder into `out`: diagnosis.json and report.html.

    simulation: where the recording holds no simulated twin: a CSV, an error model (.json) or an FMU.
    Raises UsageError, with one clear message, for input that cannot be used.
    """
    from errpipe import jsonfile
    from errpipe.errors import DataError, UsageError
    from errpipe.formats import manifest_folder

    try:
        read, notes = with_simulation(manifest_folder.read(Path(recording)), simulation)
        document, page, found = judged(read, progress, notes)
    except DataError as err:
        raise UsageError(str(err)) from None
    jsonfile.write(Path(out) / "diagnosis.json", document)
    jsonfile.write_text(Path(out) / "report.html", page)
    return {"says": [r.says for r in found.responses], "verdicts": {r.component: r.verdict for r in found.responses}}


def judged(
    recording: Recording, progress: Callable[[float, str], None], notes: tuple[str, ...] = ()
) -> tuple[dict[str, Any], str, Diagnosis]:
    """diagnosis.json as plain data, the page, and the findings. notes: what is to be said before all else."""
    from errpipe import __version__
    from errpipe.diagnosis import diagnose as judge
    from errpipe.reporting.diagnosis_report import Trace, render

    found, rows = judge(recording, progress)
    found = found.model_copy(update={"notes": (*notes, *found.notes)})
    traces = [
        Trace(before=r.before, after=r.after, run=r.run, contributions=r.contribution, inputs=r.inputs) for r in rows
    ]
    page = render(found, traces, machine=recording.manifest.machine, version=__version__)
    return found.document(), page, found


def with_simulation(recording: Recording, simulation: Path | None) -> tuple[Recording, tuple[str, ...]]:
    """The recording beside a simulation of its own file, and notes: .csv, .json (an error model) or .fmu.

    Tunable parameters of an FMU are set right on the recording first: what they can mend is not missing.
    """
    from errpipe.simulation import external
    from errpipe.stages import _artefacts

    if simulation is None:
        return recording, ()
    file = Path(simulation)
    model = _artefacts.read_model(file) if file.suffix.lower() == ".json" else None
    read, twins, figures = external.with_twins(recording, external.by_name(recording, file), file, model)
    notes = [f"{t.component}: {note}" for t in twins for note in t.notes]
    notes += [
        f"{file.name}: {told['parameter']} set right before anything was called missing: {told['start']:g} -> "
        f"{told['value']:.4g} (allowed: {told['low']:g} to {told['high']:g})"
        for told in figures.get("parameters", ())
        if told["value"] != told["start"]
    ]
    return read, tuple(notes)
