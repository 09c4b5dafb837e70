"""Garbage collection while tests run: tests, modules and models that collecting the tests makes stay until the end.

Python would search them again and again: syntax trees of the package were made four times as fast without a search.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

NEW_OBJECTS = 50_000  # between two searches (Python: 700); the command line sets 30,000


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()
        gc.set_threshold(NEW_OBJECTS)
