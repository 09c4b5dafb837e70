"""Readings of the plain-Python evaluator: acceptance, substitutes for rejected ones, and validity."""

from __future__ import annotations

from collections.abc import Mapping

from errpipe.domain import table as t

_NOWHERE = 1e31  # value of an anchor before the first reading: beyond every reading


class Readings:
    """The inputs of one table, and what is kept of them from cycle to cycle.

    Of each input, by its number: value: clipped to validity; left: share of the table that applies, 0..1;
    usable: whether it has had a accepted reading; rejected: readings that its rate refused. status: bits of the cycle.
    """

    def __init__(self, table: t.CompensationTable):
        inputs = len(table.inputs)
        self.table = table
        self.number = {i.name: n for n, i in enumerate(table.inputs)}
        self._rules_of_2 = table.table > 1
        self._raw = [float("nan")] * inputs
        self._wait = [0.0] * inputs
        self._good = [0.0] * inputs
        self._age = [0.0] * inputs
        self._anchor = [_NOWHERE] * inputs
        self.rejected = [0] * inputs
        self._now = [0.0] * inputs
        self.left = [1.0] * inputs
        self._seen = [False] * inputs
        self.usable = [i.optional for i in table.inputs]
        self.value = [0.0] * inputs
        self.status = 0

    def condition(self, readings: Mapping[str, float], dt: float, replay: bool) -> tuple[list[int], list[int], bool]:
        """Number of the fault and of the source of each input; whether an input that counts has only its default."""
        self.status = 0
        for name in readings:
            if name not in self.number:
                raise KeyError(f"the table has no input {name!r} (inputs: {', '.join(self.number)})")
        faults = [self._judge(n, i, readings, dt, replay) for n, i in enumerate(self.table.inputs)]
        sources = [0] * len(faults)
        lost = False
        for n, i in enumerate(self.table.inputs):
            if faults[n] != 0:
                sources[n] = self._substitute(n, i, faults)
                if not i.optional:
                    self.status |= t.STATUS_BIT[("", "substituted", "held", "defaulted")[sources[n]]]
                    lost = lost or (sources[n] == 3 and i.fade_on_default)
        return faults, sources, lost

    def _judge(self, n: int, channel: t.TableInput, readings: Mapping[str, float], dt: float, replay: bool) -> int:
        self._age[n] = self._age[n] + dt
        self._wait[n] = self._wait[n] + dt
        if channel.name in readings:
            self._raw[n] = float(readings[channel.name])
            self._wait[n] = 0.0
        v = self._raw[n]
        if not -t.LARGEST_RESULT <= v <= t.LARGEST_RESULT:
            return 1
        if channel.stale_after_s is not None and self._wait[n] > channel.stale_after_s:
            return 2
        if v < channel.low or v > channel.high:
            return 3
        if channel.max_rate is not None and not self._within_rate(n, channel, v, channel.name in readings, replay):
            return 4
        self._good[n] = v
        self._now[n] = v
        self._age[n] = 0.0
        self._seen[n] = True
        self.usable[n] = True
        return 0

    def _within_rate(self, n: int, channel: t.TableInput, v: float, fresh: bool, replay: bool) -> bool:
        """Whether a reading lies where `max_rate` and `noise` let it be; the anchor follows it at that rate.

        The first reading of a run is accepted once it has stayed there for half a thermal cycle.
        """
        settled = self._seen[n]
        if not settled and (replay or not self._rules_of_2):
            self._anchor[n] = v
            return True
        assert channel.max_rate is not None
        reach = channel.max_rate * self._age[n]
        moved = v - self._anchor[n]
        if moved > reach + channel.noise or -moved > reach + channel.noise:
            if not settled:
                self._anchor[n] = v
                self._age[n] = 0.0
            elif fresh:
                self.rejected[n] = (self.rejected[n] + 1) % (1 << 32)
            return False
        if not settled and self._age[n] < 0.5 * self.table.thermal_cycle_s:
            return False
        self._anchor[n] = self._anchor[n] + reach if moved > reach else self._anchor[n] - reach if -moved > reach else v
        return True

    def _substitute(self, n: int, channel: t.TableInput, faults: list[int]) -> int:
        if channel.optional:
            self._now[n] = channel.default
            return 3
        sources = [self.number[s.input] for s in channel.substitute]
        if sources and all(faults[s] == 0 for s in sources):
            v = channel.substitute_offset
            for s, part in zip(sources, channel.substitute, strict=True):
                v = v + part.weight * self._good[s]
            if v < channel.low:
                v = channel.low
            if v > channel.high:
                v = channel.high
            self._now[n] = v
            self.usable[n] = True
            return 1
        if self._seen[n] and (channel.hold_s is None or self._age[n] < channel.hold_s):
            self._now[n] = self._good[n]
            return 2
        self._now[n] = channel.default
        return 3

    def show(self, n: int, channel: t.TableInput) -> None:
        """An input clipped to its validity range, and the share of the table that applies outside it."""
        v = self._now[n]
        self.left[n] = 1.0
        if channel.valid is not None:
            low, high = channel.valid
            outside = low - v if v < low else v - high
            if outside > 0.0:
                self.left[n] = 1.0 - outside / (channel.margin or 1.0)
                if self._rules_of_2:
                    v = low if v < low else high
        self.value[n] = v
