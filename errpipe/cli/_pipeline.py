"""Pipelines that verbs read."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any


def load_pipeline_file(file: Path, sets: list[str]) -> Any:
    """The pipeline, read with the stages of errpipe. Raises ConfigError, UsageError."""
    # A hundred model classes are built here and all stay alive; garbage collection would cost 10 % of the time.
    gc.disable()
    try:
        from errpipe.pipeline.spec import load_pipeline
        from errpipe.stages import STAGES

        return load_pipeline(file, STAGES, sets=sets)
    finally:
        gc.enable()
