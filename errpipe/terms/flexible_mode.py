"""A part of the structure vibrates at its natural frequency."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.special import fdtrc

from errpipe.domain.components import is_force
from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.simulated import Ringing
from errpipe.terms._base import NEVER, Example, Parameter, Term
from errpipe.terms._drivers import scaled
from errpipe.terms._example import rows, typical_example
from errpipe.terms._fields import Axis
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._search import Estimates, Listed, Resonances, Signals, resolved_times
from errpipe.terms._slack import Slack

MAX_SAMPLE_INTERVAL = 0.1  # s; structures vibrate at some Hz and more
RATIO = 1.03  # between trial frequencies; lightly damped modes are followed by the finer steps around the best
DAMPINGS = (0.01, 0.03, 0.1)  # damping ratios tried
MIN_DAMPING, MAX_DAMPING = 1e-4, 0.25  # steel alone has more; beyond it no resonance shows in a spectrum
BLOCKS = 40  # stretches of rows, for the spread of a spectrum
CHANCE = 1e-4  # false-alarm probability; some hundred frequencies are tried
MAX_RESONANCES = 3  # resonances offered of each binding


class FlexibleMode(Term):
    """Column, slide or drive train is a spring-mass system that rings after an acceleration or a force.

    Equation   q'' + 2 damping w q' + w^2 q = w^2 u,  w = 2 pi frequency,  u = acceleration or force
               deviation = -compliance * q  (of a drive force: mass * q); with `ringing` q - u stands for q
    Assumes    one mode, excited by a recorded signal; sampling rate at least five times its frequency
    Typical    frequency 5..300 Hz, damping 0.005..0.1, 1..10 um per m/s2
    Moves      positive compliance: against the acceleration, then back and forth at the natural frequency
    Source     single degree of freedom with base excitation; Altintas 2012, ch. 3; ISO 230-8
    """

    term: Literal["flexible_mode"] = "flexible_mode"
    axis: Axis
    column: str = Field(description="Column of the acceleration.")
    on_force: bool = Field(False, description="The response is a drive force.")
    ringing: bool = Field(False, description="The simulation holds the static part: only what rings is missing.")
    family = "servo"
    only_estimated = True
    compensable = False
    simulated_log_odds = NEVER
    in_part = "never"
    searched = (
        Parameter("frequency", "Hz", (5.0, 300.0), (1e-3, 1e6), "natural frequency", search=Resonances()),
        Parameter("damping", "1", (0.005, 0.1), (1e-4, MAX_DAMPING), "damping ratio", search=Listed()),
    )
    prior_log_odds = -3.0  # the strongest of a few hundred frequencies is chosen

    def linear(self) -> tuple[Parameter, ...]:
        if self.on_force:
            return (Parameter("mass", "kg", (5.0, 2000.0), (-1e5, 1e5), "mass that vibrates"),)
        return (Parameter("compliance", "um/(m/s2)", (1.0, 10.0), (-500.0, 500.0), "static deflection per m/s2"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[FlexibleMode]:
        step, _ = resolved_times(recording)
        if recording.name("time") is None or step > MAX_SAMPLE_INTERVAL or is_radial(component):
            return
        on_force = is_force(component)
        for axis in (component[2:],) if on_force else axes_acting(recording, component):
            for column in recording.names("acceleration", axis=axis):
                for ringing in (False, True):
                    yield cls(axis=axis, column=column, on_force=on_force, ringing=ringing)

    @classmethod
    def estimates(cls, recording: Recording, component: str, signals: Signals) -> Estimates:
        """The resonances that explain most of the mismatch, at several dampings."""
        for term in cls.bind(recording, component):
            if np.isfinite(recording.array(term.column)).all() and signals.values:
                for frequency in term._strongest(recording, signals):
                    best = term._best(recording, signals, frequency)
                    if MIN_DAMPING < best[1] < 0.99 * MAX_DAMPING and term._excited(recording, signals, *best):
                        yield term, best
                        for damping in DAMPINGS:
                            yield term, (best[0], damping)

    def _excited(self, recording: Recording, signals: Signals, frequency: float, damping: float) -> bool:
        """Does the mismatch follow the input over the whole log, more than noise of that frequency would?

        Textbook: Wald test with cluster-robust variance (Liang and Zeger 1986) over blocks of neighbouring rows, for
        noise that rings loses its phase from block to block.
        """
        mode, _ = np.linalg.qr(signals.still(self._state(recording, frequency, damping)[signals.rows]))
        gain = mode.T @ signals.values[0]
        scores = mode * (signals.values[0] - mode @ gain)[:, None]
        spread = np.array([block.sum(axis=0) for block in np.array_split(scores, BLOCKS)])
        wald = float(gain @ np.linalg.lstsq(spread.T @ spread, gain, rcond=None)[0])
        return bool(fdtrc(2, BLOCKS - 2, wald / 2) < CHANCE)

    def _strongest(self, recording: Recording, signals: Signals) -> list[float]:
        """Local maxima of what a resonance explains over its frequency, the strongest first."""
        low, high = Resonances().limits(self, recording)
        if high <= low:
            return []
        trial = np.geomspace(low, high, max(int(np.log(high / low) / np.log(RATIO)), 3))
        gained = np.array([self._explained(recording, signals, f, 0.05) for f in trial])
        peak = np.flatnonzero((gained >= np.r_[0, gained[:-1]]) & (gained >= np.r_[gained[1:], 0]))
        out = []
        for f in trial[peak[np.argsort(-gained[peak])][:MAX_RESONANCES]]:
            finer = f * RATIO ** np.linspace(-1, 1, 13)
            out.append(float(max(finer, key=lambda v: self._explained(recording, signals, v, 0.02))))
        return out

    def _best(self, recording: Recording, signals: Signals, frequency: float) -> tuple[float, float]:
        """Frequency and damping near an estimated frequency that explain the mismatch best."""
        from scipy.optimize import minimize

        def loss(at: np.ndarray) -> float:
            damping = float(np.exp(min(at[1], np.log(MAX_DAMPING))))
            return -self._explained(recording, signals, frequency * float(np.exp(at[0])), damping)

        start = [[0.0, np.log(d)] for d in (0.03, 0.03, 0.1)]
        start[1][0] = 0.01
        simplex = {"initial_simplex": start, "maxfev": 60, "xatol": 1e-4, "fatol": 0.0}
        optimum = minimize(loss, start[0], method="Nelder-Mead", options=simplex).x
        return frequency * float(np.exp(optimum[0])), float(np.exp(min(optimum[1], np.log(MAX_DAMPING))))

    def _explained(self, recording: Recording, signals: Signals, frequency: float, damping: float) -> float:
        """Sum of squares of the mismatch that a mode explains beyond columns of the motion itself."""
        state = self._state(recording, frequency, damping)[signals.rows]
        own = signals.still(state / np.maximum(np.sqrt(np.mean(state**2, axis=0)), 1e-300))
        s = own.T @ signals.values[0]
        return float(s @ np.linalg.lstsq(own.T @ own, s, rcond=1e-12)[0])

    def _state(self, recording: Recording, frequency: float, damping: float) -> np.ndarray:
        """Deflection and speed of the mode, shape (rows, 2)."""
        return Ringing(self.column, frequency, damping).state(recording)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        q = self._state(recording, *nonlinear)[:, 0]
        if self.ringing:
            q = q - recording.array(self.column)
        return (self._sign * q)[:, None]

    @property
    def _sign(self) -> float:
        return 1e-3 if self.on_force else -1e-3

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered | Ringing, ...]:
        frequency, damping = self.nonlinear_values(parameters)
        gain = self._sign * parameters["mass" if self.on_force else "compliance"]
        rings = Ringing(self.column, frequency, damping, gain)
        return (rings, Lowered(scaled(Input(name=self.column), -gain))) if self.ringing else (rings,)

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield self._state(recording, *nonlinear)[:, 1], 0.3  # where it is measured it may be early or late

    @classmethod
    def example(cls) -> Example:
        return typical_example(cls(axis="X", column="ax"), rows(0.01))
