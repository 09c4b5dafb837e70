"""The stages of a pipeline: typed in, typed out, glue only. Heavy imports wait inside `run`."""

from __future__ import annotations

from errpipe.pipeline.stage import Stage
from errpipe.yamlfile import Choice

STAGES: Choice[type[Stage]] = Choice.of_files(
    "errpipe.stages",
    "kind",
    (
        "clean",
        ("diagnose", "diagnosis"),
        "export",
        "export_volumetric",
        "fit",
        "identify",
        "identify_direct",
        "identify_force",
        "ingest",
        "report",
        "simulate",
        "simulate_test",
        ("twin", "simulate_with"),
        "validate",
    ),
)
