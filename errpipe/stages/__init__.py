"""The stages of a pipeline: typed in, typed out, glue only. Heavy imports wait inside `run`."""

from __future__ import annotations

from errpipe.pipeline.stage import Stage
from errpipe.stages import fit
from errpipe.stages.clean import Clean
from errpipe.stages.diagnosis import Diagnose
from errpipe.stages.export import Export
from errpipe.stages.export_volumetric import ExportVolumetric
from errpipe.stages.identify import Identify
from errpipe.stages.identify_direct import IdentifyDirect
from errpipe.stages.ingest import Ingest
from errpipe.stages.report import Report
from errpipe.stages.simulate import Simulate
from errpipe.stages.simulate_test import SimulateTest
from errpipe.stages.simulate_with import SimulateWith
from errpipe.stages.validate import Validate

STAGES: tuple[type[Stage], ...] = (
    Clean,
    Diagnose,
    Export,
    ExportVolumetric,
    *fit.STAGES,
    Identify,
    IdentifyDirect,
    Ingest,
    Report,
    Simulate,
    SimulateTest,
    SimulateWith,
    Validate,
)
