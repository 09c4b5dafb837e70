"""exp, ln and power for kernels: the functions of `arithmetic.py`, compiled."""

from __future__ import annotations

from types import FunctionType
from typing import Any

from errpipe.kernels import arithmetic, kernel

_names: dict[str, Any] = dict(vars(arithmetic))  # of the compiled copies, which call each other
for _name in ("two_to", "exp", "ln", "power"):
    _names[_name] = kernel(FunctionType(_names[_name].__code__, _names, _name))
exp, ln, power = _names["exp"], _names["ln"], _names["power"]
