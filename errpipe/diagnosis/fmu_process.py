"""A process of its own that runs one FMU over recorded inputs: it may crash or hang without harm to its caller."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

REST = 1e-6  # s between rows whose clock stands still


def main(ask: str, answer: str) -> int:
    """Read the question, run, write the outputs row by row and the values of the tunable parameters."""
    question = json.loads(Path(ask).read_text(encoding="utf-8"))
    try:
        import fmpy
    except ImportError:
        sys.stderr.write("FMPy is not installed; install errpipe with its extra `fmu`\n")
        return 2
    Path(answer).write_text(json.dumps(run(fmpy, question)), encoding="utf-8")
    return 0


def run(fmpy: Any, question: dict[str, Any]) -> dict[str, Any]:
    """Simulate from the first to the last row; a row's output is the one at its time."""
    description = fmpy.read_model_description(question["fmu"])
    variables = {v.name: v for v in description.modelVariables}
    outputs = [v.name for v in variables.values() if v.causality == "output"]
    tunable = {
        v.name: float(v.start)
        for v in variables.values()
        if v.causality == "parameter" and v.type in ("Real", "Float64") and v.start is not None
    }
    t = np.asarray(question["t"], dtype=float)
    t = np.where(np.isfinite(t), t, 0.0)
    at = t - t[0]
    for i in range(1, at.size):
        at[i] = max(at[i], at[i - 1] + REST)  # time goes on, also where runs start at nought again
    names = [n for n in question["inputs"] if n in variables and variables[n].causality == "input"]
    signals = None
    if names:
        signals = np.zeros(at.size, dtype=[("time", float), *((n, float) for n in names)])
        signals["time"] = at
        for n in names:
            signals[n] = question["inputs"][n]
    step = float(np.median(np.diff(at))) if at.size > 1 else 1.0
    result = fmpy.simulate_fmu(
        question["fmu"], start_time=0.0, stop_time=float(at[-1]), output_interval=max(step, REST), input=signals,
        start_values=dict(question["set"]), output=outputs,
    )  # fmt: skip
    values = {n: np.interp(at, result["time"], result[n]).tolist() for n in outputs}
    return {"outputs": values, "parameters": tunable}


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1], sys.argv[2]))
