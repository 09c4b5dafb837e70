"""What `errpipe check` does, without typer."""

from __future__ import annotations

from pathlib import Path

from errpipe.errors import ConfigError, Problem


def check(files: list[Path], data: bool, style: str, as_json: bool) -> int:
    """Check configuration files; returns the exit code. style: text or github. Raises ConfigError in text."""
    from errpipe.cli._deferred import defer_plugins
    from errpipe.cli.output import print_result

    defer_plugins()
    problems: list[Problem] = []
    checked = []
    for file in files:
        inside = [file / name for name in ("recording.yaml", "pipeline.yaml")] if file.is_dir() else [file]
        path = next((p for p in inside if p.is_file()), file)
        try:
            checked.append({"file": str(path), "what": _check(path, data)})
        except ConfigError as err:
            problems += err.problems
    if problems and style == "github":
        print_result("check", {}, map(_github, sorted(problems)), as_json=False)
        return 2
    if problems:
        raise ConfigError(problems)
    print_result(
        "check", {"files": checked}, [f"{one['file']}: {one['what']}, fine" for one in checked], as_json=as_json
    )
    return 0


def _check(path: Path, data: bool) -> str:
    """What a file is. Raises ConfigError."""
    from errpipe import yamlfile
    from errpipe.cli.output import module_of

    document = yamlfile.read(path)
    keys = document.value if isinstance(document.value, dict) else {}
    if "recording" in keys:
        from errpipe.domain.written_manifest import WrittenManifest

        if data:
            module_of("verbs.check").header_of(path)
        else:
            document.validate(WrittenManifest)
        return "recording manifest"
    if "machine" in keys and "pipeline" not in keys:
        from errpipe.domain.machine import Machine

        document.validate(Machine)
        return "machine"
    if "fleet" in keys:
        fleet = module_of("verbs.fleet")
        spec = document.validate(fleet.Fleet)
        if data:
            fleet.machines_of(spec, path.parent)
        _check_pipeline(path.parent / spec.pipeline, data=False)  # whose recording each machine replaces by its own
        return "fleet"
    return _check_pipeline(path, data)


def _check_pipeline(path: Path, data: bool) -> str:
    from errpipe.cli._pipeline import load_pipeline_file
    from errpipe.cli.output import module_of

    check, pipeline = module_of("verbs.check"), load_pipeline_file(path, [])
    problems = sorted({*check.problems(pipeline, data), *check.ungated_exports(pipeline)})
    if problems:
        raise ConfigError(problems)
    return "pipeline"


def _github(problem: Problem) -> str:
    """A problem as a GitHub workflow command."""
    from errpipe.reporting.markup import workflow_command

    place = {"file": problem.file, "line": problem.line or 1, "col": problem.column or 1, "title": "errpipe"}
    return workflow_command("error", f"{problem.key}: {problem.message}" if problem.key else problem.message, **place)
