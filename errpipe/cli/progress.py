"""Progress on standard error: a line per stage, and a moving bar on an interactive terminal."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from threading import Lock
from typing import TextIO

from errpipe.pipeline.step import Callbacks, Step

_WIDTH = 24  # characters of a bar
_COLUMNS = 79  # of a line that must not wrap, or it could not be taken back
_SOON = 5.0  # s: what takes no longer needs no word on the time left


def is_interactive(stream: TextIO) -> bool:
    """Whether a moving bar makes sense: a terminal, not in CI, neither NO_COLOR nor TERM=dumb."""
    return (
        stream.isatty()
        and not any(os.environ.get(name) for name in ("CI", "NO_COLOR"))
        and (os.environ.get("TERM") != "dumb")
    )


class ProgressReporter:
    """Reports the progress of the engine. Stages may run in parallel, so every line is written under a lock."""

    def __init__(self, out: str, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic):
        self.out = out
        self._clock = clock
        self._began: dict[str, float] = {}
        self.stream = stream or sys.stderr
        self.moving = is_interactive(self.stream)
        self._lock = Lock()

    def callbacks(self) -> Callbacks:
        return Callbacks(waiting=self._waiting, started=self._started, progress=self._progress, finished=self._finished)

    def _waiting(self) -> None:
        self._line(f"another errpipe is at work in {self.out}; waiting for it")

    def _started(self, step: Step) -> None:
        self._line(f"{step.name}: runs ({'; '.join(step.reasons[:3])}{'; …' if len(step.reasons) > 3 else ''})")

    def _progress(self, name: str, fraction: float, text: str) -> None:
        if self.moving:
            fraction = min(max(fraction, 0.0), 1.0)
            done = round(_WIDTH * fraction)
            with self._lock:
                left = self._time_left(name, fraction)
                line = f"{name} [{'#' * done}{'.' * (_WIDTH - done)}] {left}{text}"
                self.stream.write(f"\r\033[K{line[:_COLUMNS]}")
                self.stream.flush()

    def _time_left(self, name: str, fraction: float) -> str:
        """How long a piece of work will still take by the share that is done; nothing where that is soon."""
        elapsed = self._clock() - self._began.setdefault(name, self._clock())
        if fraction <= 0.0 or elapsed / fraction <= _SOON:
            return ""
        left = elapsed * (1.0 - fraction) / fraction
        return f"{left:.0f} s left, " if left < 120 else f"{left / 60:.0f} min left, "

    def _finished(self, step: Step) -> None:
        if step.action == "fresh":
            self._line(f"{step.name}: nothing to do")
        elif not step.written:
            self._line(f"{step.name}: done, nothing new")
        else:
            count = len(step.written)
            self._line(f"{step.name}: done, {count} file{'s' if count != 1 else ''} written")

    def progress_of(self, name: str) -> Callable[[float, str], None]:
        """The progress callback of one piece of work."""
        return lambda fraction, text: self._progress(name, fraction, text)

    def clear(self) -> None:
        """Remove an unfinished bar from the screen."""
        if self.moving:
            with self._lock:
                self.stream.write("\r\033[K")
                self.stream.flush()

    def _line(self, text: str) -> None:
        with self._lock:
            self.stream.write(("\r\033[K" if self.moving else "") + text + "\n")
            self.stream.flush()
