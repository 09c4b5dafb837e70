"""Periodic in axis position with the encoder's signal period."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, response_share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._search import Waves
from errpipe.terms._slack import Slack, uneven_waves


class Interpolation(Term):
    """The encoder's two signals are not perfect sines: an error that repeats with every signal period.

    Equation   deviation(x) = sum over k = 1, 2 of sine_k sin(2 pi k x / period) + cosine_k cos(2 pi k x / period)
    Assumes    positions recorded finer than a tenth of the period
    Typical    0.05..1 um; period 0.004..0.1 mm (magnetic scales 1..5 mm)
    Moves      the same everywhere on the axis; one or two waves per signal period
    Source     sub-divisional error of incremental encoders (ISO 230-1, encoder makers' handbooks)
    """

    term: Literal["interpolation"] = "interpolation"
    axis: Axis
    radial: Radial = False
    harmonics: int = Field(2, description="How many harmonics of the signal period.")
    family = "geometric"
    simulated_log_odds = -4.0
    in_part = "runs"
    searched = (Parameter("period", "mm", (0.004, 0.1), (0.001, 10.0), "signal period", search=Waves()),)

    def linear(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{part}{k}", "um", (0.05, 1.0), (-20.0, 20.0), f"{part} part of harmonic {k}")
            for k in range(1, self.harmonics + 1)
            for part in ("sine", "cosine")
        )

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Interpolation]:
        for axis in axes_acting(recording, component):
            known = recording.manifest.axis(axis)
            if known is not None and known.encoder_period is not None:
                yield cls(axis=axis, radial=is_radial(component), fixed={"period": known.encoder_period})

    def _waves(self, x: np.ndarray, period: float) -> np.ndarray:
        angle = 2 * np.pi / period * np.asarray(x, dtype=float)
        return np.column_stack([f(k * angle) for k in range(1, self.harmonics + 1) for f in (np.sin, np.cos)])

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        waves = self._waves(position(recording, self.axis), nonlinear[0])
        return waves * response_share(recording, self.axis, self.radial)[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        if not self.radial:
            yield from uneven_waves(base, position(recording, self.axis))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (period,) = self.nonlinear_values(parameters)
        gains = self.gain_values(parameters)
        return (Lowered(ONE, self.axis, lambda x: self._waves(x, period) @ gains, period),)
