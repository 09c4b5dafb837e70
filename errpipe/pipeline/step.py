"""Result of one stage in a run, and its callbacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Step:
    """What is planned for, or happened to, one stage.

    action: "run", "fresh" (nothing to do) or "perhaps" (only if an earlier stage brings something new).
    written: outputs whose bytes changed. summary: returned by the stage, also if it was up to date.
    """

    name: str
    kind: str
    action: str
    reasons: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    written: tuple[str, ...] = ()
    summary: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Callbacks:
    """Callbacks for progress messages; the defaults print nothing."""

    waiting: Callable[[], None] = lambda: None
    started: Callable[[Step], None] = lambda step: None
    progress: Callable[[str, float, str], None] = lambda name, fraction, text: None
    finished: Callable[[Step], None] = lambda step: None


NO_CALLBACKS = Callbacks()
