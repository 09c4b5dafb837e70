"""What a simulation can add and no controller computes: a structure that rings, a signal that comes late."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import is_rotary, path_name
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses

REST = 0.5  # own periods without a row, after which a structure is at rest again


@dataclass(frozen=True)
class Ringing:
    """gain * q, q'' + 2 damping w q' + w^2 q = w^2 u, w = 2 pi frequency (Hz), u the column `name`."""

    name: str
    frequency: float
    damping: float
    gain: float = 1.0

    @property
    def pause(self) -> float:
        """Time between two rows from which it starts from rest, s."""
        return REST / self.frequency

    def state(self, recording: Recording) -> np.ndarray:
        """q and q' / w, shape (rows, 2)."""
        u, t, session = recording.array(self.name), recording.time(), sessions(recording)
        return responses.vibration(session, t, u, self.frequency, self.damping, self.pause)

    def value(self, recording: Recording) -> np.ndarray:
        """On every row, shape (rows,)."""
        return self.gain * self.state(recording)[:, 0]


def between(t: np.ndarray, u: np.ndarray, when: np.ndarray) -> np.ndarray:
    """u at other times by its natural cubic spline, shape of `when`; held before the first row and after the last.

    Straight lines would take a curvature of u (a mass, for a velocity) for a delay of part of a row.
    Numpy alone, as its source is printed into the patches of `diagnose --apply`, which need no other package.
    """
    h, steep = np.diff(t), np.diff(u) / np.diff(t)
    before, after, steep = np.r_[0.0, h], np.r_[h, 0.0], np.r_[steep[0], steep, steep[-1]]
    wanted, slope = 3.0 * (after * steep[:-1] + before * steep[1:]), np.gradient(u, t)
    for _ in range(20):  # Jacobi: each halves the error of the slopes
        padded = np.r_[slope[1], slope, slope[-2]]
        slope = (wanted - after * padded[:-2] - before * padded[2:]) / (2.0 * (before + after))
    k = np.clip(np.searchsorted(t, when, side="right") - 1, 0, t.size - 2)
    s = np.clip((when - t[k]) / h[k], 0.0, 1.0)
    left, right = (h[k] * (slope[k + i] - steep[k + 1]) for i in (0, 1))
    return u[k] + s * h[k] * steep[k + 1] + s * (1.0 - s) * ((1.0 - s) * left - s * right)


@dataclass(frozen=True)
class DelayDifference:
    """gain * (u(t - delay) - u(t)), u the column `name` or the path of `axis` in um (urad); delay in s."""

    delay: float
    name: str | None = None
    axis: str | None = None
    gain: float = 1.0

    def column(self, recording: Recording) -> tuple[str, float]:
        """Name of the column that comes late, and what it is multiplied by to be um (urad)."""
        if self.axis is None:
            return str(self.name), 1.0
        return path_name(recording, self.axis), np.pi / 180e-6 if is_rotary(recording, self.axis) else 1e3

    def signal(self, recording: Recording) -> np.ndarray:
        """u on every row, shape (rows,)."""
        name, factor = self.column(recording)
        return recording.array(name) * factor

    def value(self, recording: Recording) -> np.ndarray:
        """On every row, shape (rows,); held before the first of a session; NaN where u is."""
        t, session, u = recording.time(), sessions(recording), self.signal(recording)
        before, known = np.full(u.shape, np.nan), np.flatnonzero(np.isfinite(u))
        edges = np.r_[0, np.flatnonzero(np.diff(session[known])) + 1, known.size]
        for first_row, last_row in itertools.pairwise(edges):
            inside = known[first_row:last_row]
            own, values = t[inside], u[inside]
            at, first = (own, slice(None)) if np.all(own[1:] > own[:-1]) else np.unique(own, return_index=True)
            if at.size > 1:
                before[inside] = between(at, values[first], own - self.delay)
        return self.gain * (before - u)
