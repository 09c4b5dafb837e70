"""Slope along the axis that builds up with the axis' own motion and decays at rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_at_tool
from errpipe.domain.driver import Lag
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import axes, direction, position, position_name
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.kernels.events import travelled
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import magnitude, scaled
from errpipe.terms._fields import Axis
from errpipe.terms._place import linear_axes_acting
from errpipe.terms._search import Times
from errpipe.terms._slack import Slack, bent, start_states, unit_interval
from errpipe.yamlfile import quantity

PER_MINUTE = 1.0 / 60.0  # mm/s in a feed of 1 mm/min
VISCOUS = 0.5  # prior standard deviation of the heat of viscous friction over that of dry friction: as much as it
OF_SESSION = 4.5  # of the longest time constant searched for (a third of a session): a single stroke is no limit
EITHER_END = 1.7  # of a screw, seen from mid-travel or from the other end: half its length over its rms, or all of it
WHERE_IT_WORKS = 0.2  # and of what a screw that is warm in one half grows more there


class SlowerThanStrokes(Times):
    """A time constant no shorter than the time between two turns: in less, a screw is warm in places and no slope."""

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        low, high = super().limits(term, recording)
        run, side = sessions(recording), direction(recording, term.axis)
        turns = np.r_[True, (np.diff(side) != 0) | (np.diff(run) != 0)]
        strokes = np.diff(np.r_[recording.time()[turns], recording.time()[-1]])
        return max(low, min(float(np.median(strokes)), high / OF_SESSION)), high


class FeedHeating(Term):
    """Friction of the nut heats the screw: it expands with the distance travelled, and recovers at rest.

    Equation   tau dy/dt + y = |v| / 100 mm/s;  deviation = slope * (x - fixed_end) * y   [um] = [um/m] * [m]
    Assumes    the screw warms uniformly and expands from its fixed bearing; heat proportional to the distance travelled
    Typical    10..60 um/m at steady running, tau 1000..6000 s
    Moves      positive slope: the axis travels further and further past its targets while it runs
    Source     Ni 1997; ISO 230-3 (linear motion of components)
    """

    term: Literal["feed_heating"] = "feed_heating"
    axis: Axis
    column: str | None = Field(None, description="Column of the velocity that heats; none: the axis' own travel.")
    cycled: bool = Field(False, description="The column is a feed in mm/min at which the axis cycles between readings.")
    fixed_end: float = quantity("mm", "Position of the screw's fixed bearing, from where it grows.", 0.0)
    family = "thermal"
    form = "any start and end"
    gains = (Parameter("slope", "um/m", (10.0, 60.0), (-1000.0, 1000.0), "slope at 100 mm/s, warmed through"),)
    searched = (Parameter("tau", "s", (1000.0, 6000.0), (100.0, 40000.0), "time constant", search=SlowerThanStrokes()),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        names = (position_name(recording, self.axis), self.column, recording.name("feed", axis=self.axis))
        return tuple(dict.fromkeys(n for n in names if n))

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[FeedHeating]:
        if is_at_tool(component):
            return  # motion this slow does not warm a screw
        for axis in linear_axes_acting(recording, component):
            known = recording.manifest.axis(axis)
            end = known.drive_end if known is not None and known.drive_end is not None else 0.0
            yield cls(axis=axis, column=recording.name("velocity", axis=axis), fixed_end=end)
            alone = axes(recording) + axes(recording, "rotary") == (axis,)  # a feed that names no axis is its own
            for feed in recording.names("feed", axis=None if alone else axis):  # a warm-up is read now and then
                if np.nanstd(recording.array(feed)) > 0:
                    yield cls(axis=axis, column=feed, cycled=True, fixed_end=end)

    def speed(self, recording: Recording) -> np.ndarray:
        """Mean speed from each row to the next in mm/s, shape (rows,).

        Where rows only log (no response recorded) the feed is the speed; elsewhere the distance moved over the
        time passed, because the axis dwells between targets.
        """
        if self.column:
            return np.abs(recording.array(self.column)) * (PER_MINUTE if self.cycled else 1.0)
        run, t = sessions(recording), recording.time()
        step = np.diff(t)
        distance = travelled(run, position(recording, self.axis))[1:]
        step_speed = np.divide(distance, step, out=np.zeros_like(distance), where=step > 0)
        feed = recording.name("feed", axis=self.axis) or recording.name("feed")
        errors = recording.names("error")
        if feed is not None and errors:
            logged = np.isnan(np.column_stack([recording.array(n) for n in errors])).all(axis=1)
            step_speed = np.where(logged[1:] & logged[:-1], recording.array(feed)[:-1] / 60.0, step_speed)
            step_speed = np.where(logged[1:] & ~logged[:-1], recording.array(feed)[1:] / 60.0, step_speed)
        return np.nan_to_num(np.r_[step_speed, 0.0])

    def _warming(self, recording: Recording, tau: float, more: float | np.ndarray = 1.0) -> np.ndarray:
        heat = self.speed(recording) / 100.0 * more
        return responses.lag(sessions(recording), recording.time(), heat, tau, tau, False)

    def _reach(self, recording: Recording) -> np.ndarray:
        return (position(recording, self.axis) - self.fixed_end) * 1e-3

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (self._warming(recording, *nonlinear) * self._reach(recording))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        x = position(recording, self.axis)
        for column, freedom in start_states(recording, nonlinear[0], 0.1, 0.5):
            yield column * x, freedom
        # the fixed bearing is unknown: at either end of travel, and positions may be counted from its middle
        yield self._warming(recording, *nonlinear) * 1e-3 * (np.nanmax(x) - np.nanmin(x)), EITHER_END
        yield x, 0.2
        yield from bent(base[:, 0], x)
        for factor in (0.3, 3.0):
            yield self.basis(recording, nonlinear[0] * factor)[:, 0], 0.25
        # viscous friction warms with the square of the speed, and the nut warms the screw where it works
        along = unit_interval(x)
        for more, freedom in ((self.speed(recording) / 100.0, VISCOUS), (along, WHERE_IT_WORKS)):
            warmed = self._warming(recording, nonlinear[0], more) * self._reach(recording)
            yield warmed, freedom
            yield warmed * along, freedom

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        if self.column is None:
            return None  # the distance moved between two rows is no operation of a driver
        (tau,) = self.nonlinear_values(parameters)
        slope, end, scale = 1e-3 * parameters["slope"], self.fixed_end, PER_MINUTE if self.cycled else 1.0
        warming = Lag(tau_up=tau, tau_down=tau, start="zero", of=scaled(magnitude(self.column), 0.01 * scale))
        return (Lowered(warming, self.axis, lambda x: slope * (x - end)),)
