"""The main job on a simulated machine: a ball-screw axis over nine thermal states, from raw readings to a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

PIPELINE = "ball-screw-axis.yaml"


def demo(out: Path, callbacks: Any) -> dict[str, Any]:
    """Run the demonstration pipeline into `out`; the three numbers that matter and where the report is."""
    from errpipe import jsonfile
    from errpipe.pipeline import runner
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES

    runner.run(load_pipeline(pipeline_file(), STAGES, sets=[]), Path(out), callbacks=callbacks)
    (figures,) = jsonfile.read(Path(out) / "validate" / "validation.json")["components"]
    report = Path(out) / "report" / "report.html"
    return {
        "component": figures["component"],
        "rms_before_um": figures["rms_before"],
        "rms_after_um": figures["rms_after"],
        "noise_floor_um": figures["noise_floor"],
        "report": str(report),
        "says": [
            f"uncompensated               {figures['rms_before']:8.2f} um rms",
            f"residual, held-out runs     {figures['rms_after']:8.2f} um rms",
            f"noise floor                 {figures['noise_floor']:8.2f} um rms",
            f"report  {report}",
            f"next    errpipe whatis {Path(out) / 'export' / 'table.ect'}",
        ],
    }


def pipeline_file() -> Path:
    """The demonstration pipeline: of the checkout, or the copy that was installed."""
    import errpipe

    package = Path(errpipe.__file__).parent
    in_checkout = package.parent / "pipelines" / PIPELINE
    return in_checkout if in_checkout.is_file() else package / "stages" / "templates" / PIPELINE
