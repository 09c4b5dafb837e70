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


def defer_plugins() -> None:
    """Let `importlib.metadata` wait, which pydantic takes a function of for plugins that it then does not look for.

    It costs 7 % of a check, most of it for the package `email`.
    """
    defer("importlib.metadata")
    module = sys.modules["importlib.metadata"]
    if isinstance(module, _Deferred):
        later = {"__path__": [], "entry_points": lambda **which: module.__getattr__("entry_points")(**which)}
        vars(module).update(later)  # `from importlib.metadata import entry_points` asks for both
