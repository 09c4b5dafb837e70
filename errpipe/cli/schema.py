"""`errpipe schema`, and the list of schemas that errpipe publishes."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import typer

# name (of schemas/<name>.schema.json) -> title and model, as module:class
MODELS = {
    "pipeline": ("errpipe pipeline, version 1", "errpipe.stages:STAGES"),
    "recording": ("errpipe recording manifest, version 1", "errpipe.domain.recording:Manifest"),
    "machine": ("errpipe machine, version 1", "errpipe.domain.machine:Machine"),
    "fleet": ("errpipe fleet, version 1", "errpipe.verbs.fleet:Fleet"),
    "error_model": ("errpipe error model, version 1", "errpipe.domain.error_model:ErrorModel"),
    "table": ("errpipe compensation table, version 1", "errpipe.domain.table:CompensationTable"),
}

WRITTEN = ("pipeline", "recording", "machine", "fleet")  # by people, in YAML; the others are JSON


def command(
    name: str = typer.Argument("pipeline", metavar="[NAME]", help=f"One of: {', '.join(MODELS)}."),
    write: Path | None = typer.Option(None, "--write", metavar="DIR", help="Write all schemas into DIR instead."),
) -> None:
    """Print a JSON Schema, for editors and other programs.

    \b
    Example:
      errpipe schema recording
      errpipe schema --write schemas
    """
    from errpipe import jsonfile
    from errpipe.errors import UsageError, did_you_mean

    if write is not None:
        for each in MODELS:
            jsonfile.write(write / f"{each}.schema.json", schema_of(each))
        return
    if name not in MODELS:
        raise UsageError(f"no schema {name!r} (allowed: {', '.join(MODELS)}).{did_you_mean(name, MODELS)}")
    typer.echo(jsonfile.dumps(schema_of(name)), nl=False)


def schema_of(name: str) -> dict[str, Any]:
    """One published schema, generated."""
    from errpipe.pipeline.schema import json_schema
    from errpipe.pipeline.spec import pipeline_model

    title, where = MODELS[name]
    module, _, attribute = where.partition(":")
    declared = getattr(import_module(module), attribute)
    model = pipeline_model(declared) if name == "pipeline" else declared
    return json_schema(model, title, written=name in WRITTEN)
