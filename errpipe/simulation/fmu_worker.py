"""Runs one FMU in a process of its own: started as a script, never imported. What crashes here, crashes here alone.

Orders come as lines of JSON on standard input, answers go out as lines of JSON on what was standard output; the FMU's
own prints go to standard error. Arrays travel as .npy files in the folder that the process was started in.

    {"do": "load", "fmu": "model.fmu", "memory_mb": 2048}
    {"do": "simulate", "inputs": "in.npy", "output": "out.npy", "outputs": [...], "start_values": {...},
     "stop": 3600.0, "step": 1.0, "kind": "CoSimulation"}
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any


def limit(memory_mb: int) -> None:
    """No more address space than this, and no core dumps."""
    try:
        import resource
    except ImportError:  # Windows: the time limit has to do
        return
    size = memory_mb * 1024 * 1024
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (size, size))


def unit_of(variable: Any) -> str | None:
    """A variable's unit: its own, or its declared type's."""
    declared = getattr(variable, "declaredType", None)
    return variable.unit or (declared.unit if declared is not None else None)


def describe(model: Any) -> dict[str, Any]:
    """What the parent needs to know of the model description."""
    experiment = model.defaultExperiment
    kinds = [k for k, have in (("CoSimulation", model.coSimulation), ("ModelExchange", model.modelExchange)) if have]
    return {
        "name": model.modelName,
        "version": model.fmiVersion,
        "kinds": kinds,
        "step": getattr(experiment, "stepSize", None) if experiment is not None else None,
        "variables": {
            v.name: {
                "causality": v.causality,
                "variability": v.variability,
                "type": v.type,
                "unit": unit_of(v),
                "start": None if v.start is None else str(v.start),
                "scalar": not v.dimensions,
                "min": getattr(v, "min", None),
                "max": getattr(v, "max", None),
            }
            for v in model.modelVariables
        },
    }


class Work:
    """The loaded FMU, unpacked in the process' own folder."""

    def load(self, order: dict[str, Any]) -> dict[str, Any]:
        limit(order["memory_mb"])
        import fmpy

        self.folder = fmpy.extract(order["fmu"], unzipdir=os.path.abspath("unpacked"))
        self.model = fmpy.read_model_description(self.folder)
        return describe(self.model)

    def simulate(self, order: dict[str, Any]) -> dict[str, Any]:
        import fmpy
        import numpy as np

        signals = None
        if order.get("inputs"):
            plain = np.load(order["inputs"], allow_pickle=False)
            kinds = {v.name: v.type for v in self.model.modelVariables}
            types = [(n, _dtype(kinds.get(n, "Real"))) for n in plain.dtype.names]
            signals = np.empty(plain.shape, dtype=types)
            for name in plain.dtype.names:
                signals[name] = plain[name]
        result = fmpy.simulate_fmu(
            self.folder,
            model_description=self.model,
            fmi_type=order["kind"],
            start_time=0.0,
            stop_time=order["stop"],
            output_interval=order["step"],
            step_size=order["step"],
            input=signals,
            output=order["outputs"],
            start_values=order["start_values"],
            validate=False,
        )
        table = np.column_stack([np.asarray(result[n], dtype=float) for n in ("time", *order["outputs"])])
        np.save(order["output"], table, allow_pickle=False)
        return {"rows": len(table)}


def _dtype(kind: str) -> type:
    return {"Real": float, "Float64": float, "Float32": float, "Boolean": bool}.get(kind, int)


def main() -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever the FMU prints must not be taken for an answer
    work = Work()
    for line in sys.stdin:
        order = json.loads(line)
        try:
            answer = {"ok": getattr(work, {"load": "load", "simulate": "simulate"}[order["do"]])(order)}
        except MemoryError:
            answer = {"error": "out of memory"}
        except Exception as err:
            answer = {"error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
