"""An identification as one JSON document: constants, curves with 95 % intervals, set-up, unobserved combinations.

`document` writes it for `jsonfile`, `errors` reads it back, so that a report, a table and a later closed-loop
check all start from the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from errpipe.errors import VerifyError
from errpipe.kinematics import observability, residual_error, synthesis
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.errors import MachineErrors, interpolated
from errpipe.kinematics.identify import Identified
from errpipe.kinematics.observations import Observations

NODES, PER_WAVE = 65, 8  # points of a curve: at least; per wave of its basis (chords then miss 2 % of it)
PLACES = 200  # random positions at which the predicted error and its second-order part are evaluated


def document(
    identified: Identified, obs: Observations, *, extra: bool = True, missed: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """The identification as JSON values in um, urad, mm, deg; `extra` proposes measurements for what is unobserved.

    missed: rms lack of fit of a component's curve (um, urad), added to its standard error in quadrature.
    """
    chain = identified.model.chain
    without = tuple(n for i, n in enumerate(chain.components) if i not in set(identified.model.prior.component))
    seen = observability.analyse(chain, obs, noise=identified.noise, without=without)
    curves = {}
    for c, name in enumerate(chain.components):
        if chain.drives[c] < 0 or name in without:
            continue
        low, high = chain.travel[chain.drives[c]]
        p = np.linspace(low, high, max(NODES, PER_WAVE * identified.model.bases[chain.drives[c]].modes // 2 + 1))
        value, error = identified.component(name, p)
        error = np.hypot(error, (missed or {}).get(name, 0.0))
        curves[name] = {
            "unit": chain.unit(name),
            "start": float(p[0]),
            "step": float(p[1] - p[0]),
            "value": _numbers(value),
            "half_width95": _numbers(1.96 * error),
        }
    constants = [row | {"ci95": list(row["ci95"]), "seen": float(row["seen"])} for row in identified.table()]
    q = np.random.default_rng(0).uniform(chain.travel[:, 0], chain.travel[:, 1], (PLACES, len(chain.axes)))
    value, error = identified.predict(q)
    out = {
        "identification": 1,
        "machine": chain.machine.name,
        "readings": identified.rows,
        "noise_um": identified.noise * float(np.sqrt(np.mean(obs.noise**2))),
        "residual_rms_um": float(np.sqrt(np.mean(identified.residual**2))),
        "smoothness": identified.power,
        "spread_before": identified.sizes,
        "constants": constants,
        "curves": curves,
        "setup": {n: {"value": v, "standard_error": e} for n, (v, e) in identified.setup.items()},
        "volumetric": {
            "rms_um": float(np.sqrt(np.mean(np.sum(value**2, axis=1)))),
            "standard_error_um": float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
            **residual_error.expected(identified).document(),
            "beyond_first_order": synthesis.remainder(chain, q, identified.errors().at(q)),
        },
        "rank": seen.rank,
        "parameters": seen.parameters,
        "seen": seen.seen,
        "unseen": [{"components": list(u.components), "left": u.left, "says": u.sentence()} for u in seen.unobserved],
    }
    if extra and seen.unobserved:
        added = observability.smallest_extra(chain, obs, noise=identified.noise, without=without)
        out["would_show"] = [
            {"measure": e.name, "shows": list(e.resolves), "readings": e.readings, "minutes": e.minutes} for e in added
        ]
    return out


def _numbers(values: np.ndarray) -> list[float]:
    """Plain floats, to a tenth of a nanometre: more digits are noise of the arithmetic."""
    return [round(float(v), 4) + 0.0 for v in values]


def errors(chain: Chain, parameters: Mapping[str, Any], factors: Mapping[str, float] | None = None) -> MachineErrors:
    """The components that `document` wrote, or those named in `factors`, times these; the others are zero.

    Raises VerifyError if they are of another machine or version.
    """
    if parameters.get("identification") != 1:
        raise VerifyError(f"not an identification of version 1 (found {parameters.get('identification')!r})")
    if parameters["machine"] != chain.machine.name:
        raise VerifyError(f"the identification is of machine {parameters['machine']!r}, not of {chain.machine.name!r}")
    of = dict.fromkeys(chain.components, 1.0) if factors is None else factors
    values: dict[str, Any] = {
        row["component"]: of.get(row["component"], 0.0) * float(row["value"]) for row in parameters["constants"]
    }
    nodes = 201  # of a curve over its axis, at least
    for name, curve in parameters["curves"].items():
        values[name] = interpolated({**curve, "value": of.get(name, 0.0) * np.array(curve["value"])})
        nodes = max(nodes, len(curve["value"]))
    return MachineErrors.of(chain, values, nodes)
