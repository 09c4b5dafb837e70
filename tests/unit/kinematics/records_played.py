"""Records of one axis as a laser or an autocollimator makes them, and what is identified from them."""

from __future__ import annotations

import numpy as np
from machines import ready

from errpipe.domain.recording import Recording
from errpipe.kinematics import identify, records
from errpipe.simulation import direct_records as played
from errpipe.simulation import metrology

AIR = {"dead_path": 2000.0}
COSINE = {"misalignment": 4000.0}
ABBE = {"offset": (0.0, -150.0, 120.0)}
WAVELENGTH = {"wavelength_corrected": False}


def of_axis(recording: Recording, axis: str) -> Recording:
    """The rows of one axis, and no component of another."""
    codes, labels = recording.run_codes(), recording.run_labels()
    mine = [k for k, n in enumerate(labels) if n.startswith(axis)]
    part = recording.take(np.isin(codes, mine))
    gone = [n for n in part.frame.columns if n[:1] == "E" and n[2:] != axis]
    gone += [n for n, c in part.manifest.columns.items() if c.axis not in (None, axis)]
    columns = {n: c for n, c in part.manifest.columns.items() if n not in gone}
    return Recording(part.manifest.model_copy(update={"columns": columns}), part.frame[list(columns)])


def solve(chain, recording, axis="X", modes=12, **options):
    without = tuple(n for n in chain.components if n[0] != "E" or n[2:] != axis)
    model = identify.Parametrisation.of(chain, modes, without)
    return identify.identify(model, records.observations(chain, {"": recording}, **options))


def played_x(beam: dict, seed=3, **setup):
    chain = ready("vertical-centre")
    values = metrology.smooth_machine(chain, seed)
    beams = {"EXX": played.Laser(**beam)}
    options = {"noise": 0.05, "angle_noise": 0.1, "beams": beams} | setup
    return chain, values, of_axis(played.record(chain, values, played.SetUp(**options), seed), "X")


def largest_gap(chain, values, found, component="EXX"):
    p = np.linspace(*chain.travel[chain.axes.index(component[2:])], 101)
    return float(np.abs(found.component(component, p)[0] - values[component](p)).max())
