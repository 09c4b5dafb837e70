"""`errpipe run`."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from errpipe import jsonfile
from errpipe.cli._arguments import Force, Json, Out, PipelineFile, Sets, To, output_folder
from errpipe.cli.output import module_of, print_result, short_value
from errpipe.errors import ConfigError, DataError, GateError

if TYPE_CHECKING:
    from errpipe.cli.progress import ProgressReporter
    from errpipe.pipeline.spec import Pipeline
    from errpipe.pipeline.step import Step

FOR_PEOPLE = (".html", "CHECKLIST.md")  # ends of files that are named at the end: what to look at, and to do next


def command(
    pipeline: Path = PipelineFile,
    out: Path | None = Out,
    to: str | None = To,
    sets: list[str] = Sets,
    force: list[str] = Force,
    jobs: int = typer.Option(1, "--jobs", "-j", min=1, metavar="N", help="Number of stages that may run in parallel."),
    depfile: Path | None = typer.Option(None, "--depfile", metavar="FILE", help="Write the inputs as a rule for make."),
    depfile_target: str | None = typer.Option(
        None, "--depfile-target", metavar="NAME", help="Target of that rule; default: the stamp, else the lock file."
    ),
    stamp: Path | None = typer.Option(
        None, "--stamp", metavar="FILE", help="At the end touch this file, with the time when the run began."
    ),
    json: bool = Json,
) -> None:
    """Bring the outputs of a pipeline up to date.

    Only stages run whose inputs, parameters, code or outputs differ from those of the last run.

    \b
    Example:
      errpipe run pipelines/ball-screw-axis.yaml --to fit --out out/axis
      errpipe run pipelines/ball-screw-axis.yaml --depfile run.d --stamp run.stamp
    """
    from errpipe.cli.progress import ProgressReporter
    from errpipe.pipeline import unchanged

    folder, begun = output_folder(pipeline, out), time.time_ns()
    reporter = ProgressReporter(str(folder))
    whole = to is None and not force and depfile is None
    known = unchanged.steps(pipeline, folder, sets, reporter.callbacks()) if whole else None
    if known is None:
        spec, steps = _run(pipeline, folder, sets, to, force, jobs, reporter)
        if whole:
            unchanged.note(spec, folder, sets)
        _write_depfile(spec, folder, steps, depfile, depfile_target, stamp)
        known = spec.title, steps
    if stamp is not None:
        from errpipe.pipeline.depfile import touch

        touch(stamp, begun)
    title, steps = known
    result = {"title": title, "out": str(folder), "stages": [_plain(step) for step in steps]}
    lines = [
        f"{s.name}: {', '.join(_entry_text(key, short_value(value)) for key, value in sorted(s.summary.items()))}"
        for s in steps
        if s.summary
    ]
    pages = [f"{folder / s.name / file}" for s in steps for file in s.outputs if file.endswith(FOR_PEOPLE)]
    print_result("run", result, [*lines, *pages], as_json=json)


def _entry_text(key: str, value: str) -> str:
    """An entry of a stage's summary in words: a key that ends in `_um` or `_urad` brings its unit."""
    name, _, unit = key.rpartition("_")
    return f"{name.replace('_', ' ')} {value} {unit}" if unit in ("um", "urad") else f"{key} {value}"


def _run(
    pipeline: Path,
    folder: Path,
    sets: list[str],
    to: str | None,
    force: list[str],
    jobs: int,
    reporter: ProgressReporter,
) -> tuple[Pipeline, list[Step]]:
    """Read the pipeline and run what must run; a refusal (exit code 4) writes its report first."""
    from errpipe.cli._pipeline import load_pipeline_file
    from errpipe.pipeline import runner

    spec = load_pipeline_file(pipeline, sets)
    try:
        return spec, runner.run(spec, folder, to=to, force=force, jobs=jobs, callbacks=reporter.callbacks())
    except GateError as err:
        _refuse_names(spec, err)
        page = module_of("verbs.refusal").write_report(spec, folder, str(err))
        if page is not None:
            reporter.clear()
            sys.stderr.write(f"{page}: the report, with the reason\n")
        raise
    except DataError as err:
        _refuse_names(spec, err)
        raise
    finally:
        reporter.clear()


def _refuse_names(spec: Pipeline, err: Exception) -> None:
    """Raise ConfigError with all positions if the cause of a refusal is in the pipeline file."""
    problems = [p for p in module_of("verbs.check").problems(spec) if p.file == spec.document.file]
    if problems:
        raise ConfigError(problems) from err


def _plain(step: Step) -> dict[str, Any]:
    """One stage of the JSON document."""
    names = ("name", "kind", "action", "reasons", "outputs", "written")
    return {name: getattr(step, name) for name in names} | {"summary": dict(step.summary)}


def _write_depfile(
    spec: Pipeline, folder: Path, steps: Sequence[Step], depfile: Path | None, target: str | None, stamp: Path | None
) -> None:
    """Write the inputs as a rule, if asked to."""
    if depfile is None:
        return
    from errpipe.pipeline import depfile as make

    stages = [spec.stage(step.name) for step in steps]
    name = target or str(stamp or folder / "errpipe.lock")
    jsonfile.write_text(depfile, make.depfile(name, make.inputs_of(spec, stages)))
