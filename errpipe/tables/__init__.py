"""Error model -> compensation table -> evaluators: compile, `.ect` file, reference, Numba, C runtime.

compile_table     components as profile x driver pairs -> CompensationTable (`compile`)
ect               the binary file and its JSON twin: `ect.write`, `ect.read`
reference         plain-Python evaluator, the definition; `batch`: Numba over recordings and over points
limits            how fast corrections may move by default: `limited`
bounds            what a table can reach and what a cycle costs, before it runs; `held`: what holding slow nodes costs
"""

from __future__ import annotations

from errpipe.domain.synthesis import MonomialSource, OutputSource
from errpipe.tables.compile import ComponentSource, Limits, by_component, compile_table, outputs_of, with_limits
from errpipe.tables.limits import limited

__all__ = [
    "ComponentSource",
    "Limits",
    "MonomialSource",
    "OutputSource",
    "by_component",
    "compile_table",
    "limited",
    "outputs_of",
    "with_limits",
]
