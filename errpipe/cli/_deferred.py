"""Packages that are imported when something of them is first used, for verbs that mostly need none of them.

A model's file imports numpy for its arithmetic and pandas for its tables; a check asks only for its fields. Within
this process `import numpy` then yields a stand-in; the first attribute asked of it imports the package and puts it in
the place of the stand-in wherever a module holds that.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class _Deferred(ModuleType):
    def __getattr__(self, attribute: str) -> Any:
        name = self.__name__
        if sys.modules.get(name) is self:
            del sys.modules[name]
        real = import_module(name)
        for module in list(sys.modules.values()):
            for own_name, value in list(getattr(module, "__dict__", {}).items()):
                if value is self:
                    setattr(module, own_name, real)
        return getattr(real, attribute)


def defer(*names: str) -> None:
    """Let each of these packages wait until it is used, unless it is imported already."""
    for name in names:
        package, _, child = name.rpartition(".")
        module = sys.modules.setdefault(name, _Deferred(name))
        if package:
            vars(sys.modules[package]).setdefault(child, module)
