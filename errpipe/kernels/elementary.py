"""Functions that the reference evaluator runs as plain Python (`arithmetic`, `motion`), compiled for kernels."""

from __future__ import annotations

from types import FunctionType, ModuleType
from typing import Any

from errpipe.kernels import Kernel, arithmetic, bare_kernel, motion


def compiled(module: ModuleType, *names: str) -> tuple[Kernel, ...]:
    """Kernels of functions of a module, which call each other's compiled copies."""
    copies: dict[str, Any] = dict(vars(module))
    for name in names:
        copies[name] = bare_kernel(FunctionType(copies[name].__code__, copies, name))
    return tuple(copies[name] for name in names)


_, exp, ln, power = compiled(arithmetic, "two_to", "exp", "ln", "power")
towards, can_stop, closing_rate = compiled(motion, "towards", "can_stop", "closing_rate")
moved_side, on_grid, on_lines = compiled(motion, "moved_side", "on_grid", "on_lines")
