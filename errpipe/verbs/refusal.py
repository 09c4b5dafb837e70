"""The report of a run whose export was refused, with the reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from errpipe.errors import ErrpipeError


def write_report(pipeline: Any, out: Path, reason: str) -> Path | None:
    """Run the pipeline's report without the stages that give tables; where the page is, None if there is none."""
    from errpipe.pipeline import runner
    from errpipe.pipeline.graph import link
    from errpipe.stages.report import Report

    reports = [stage for stage in pipeline.stages if isinstance(stage, Report)]
    if not reports:
        return None
    kept = []
    for stage in pipeline.stages:
        if isinstance(stage, Report):
            source = {slot: names for slot, names in stage.source.items() if slot != "tables"}
            kept.append(stage.model_copy(update={"refusal": reason, "source": source}))
        elif "table" not in stage.gives:
            kept.append(stage)
    links, wrong = link(kept)
    if wrong:
        return None
    try:
        runner.run(replace(pipeline, stages=tuple(kept), links=links), Path(out), to=reports[0].label)
    except ErrpipeError:
        return None
    page = Path(out) / reports[0].label / "report.html"
    return page if page.is_file() else None
