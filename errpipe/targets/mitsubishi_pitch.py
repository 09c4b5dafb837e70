"""Mitsubishi M6x / C6x / M7x memory type machine error compensation, incremental: parameters to be entered.

Value     half units of output (0.5 um), INCREMENTAL: on the plus side of the reference point twice (division interval
          - actual distance) from n - 1 to n, on the minus side twice (division interval + actual distance) from n + 1
          to n (C64 manual p. 280). Both say: the increase of the correction in plus over that interval, in half
          units.
Rounding  the running sum is rounded, not each step.
Limits    -128..127; the same in both directions; lost motion belongs to the axis' own backlash parameter. The numbers
          of the parameters are from experience.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError, VerifyError
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, Curve, ReadBack, expect
from errpipe.targets._screw_map import ScrewMap

UNIT = 0.5e-3  # mm: half a unit of output of 1 um
FILE = "machine_error.txt"
# Parameter numbers of the first axis.
KEYS = {"cmpax": 4001, "drcax": 4002, "rdvno": 4003, "mdvno": 4004, "pdvno": 4005, "sc": 4006, "spcdv": 4007}
FIRST = 4100  # parameter number before division point 1
LARGEST = 127  # half units in one parameter
PER_AXIS = 10  # parameters from one axis' set to the next


class MitsubishiPitch(ScrewMap):
    """Division points of each axis around its reference point, the mean of both directions."""

    name = "mitsubishi_pitch"
    controller = "Mitsubishi M6x, C6x, M7x"
    confidence = "experimental"
    sign = "a running sum above zero moves the axis in plus (prove it on the machine)"
    limits = "half micrometres; -128..127 a division; one curve for both directions; linear axes only"
    unit = "half units of output of 1 um: a metric machine; one with other units does not take them"
    holds = ("screw",)
    linear_only = "the manuals consulted do not state how a turn is divided"
    keeps_level = False
    rounding_um = 1.0
    remark = {"": "# {}"}
    source = "Mitsubishi C64 set-up manual p. 280, E68 p. II-292 (machine error compensation, incremental)"
    activation = (
        "the reference point must lie at machine coordinate 0; enter cmpax and drcax (the axis), then the numbers",
        "power off and on, reference the axis; compare three points with a gauge",
    )

    max_points, error_um = 500, 0.5

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        lines, first = [f"# {CAUTION}"], 1
        axes = [axis for _, axis in cls.own_axes(table)]
        for number, axis in enumerate(axes):
            points, _ = _sample.uniform(table, axis, axis, cls.max_points, cls.error_um)
            at, step, values = _divided(table, axis, points.step, cls.max_points)
            lines += _block(number, axis, first, step, at, values)
            first += at.size
        return {FILE: "\n".join([*lines, "# end", ""])}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.rstrip().endswith("# end"), FILE, "is cut off")
        facts = {int(k): v for k, v in re.findall(r"^#(\d+) = (\S+)", text, re.M)}
        sets = [n for n in range(1 + max(facts) // PER_AXIS) if KEYS["cmpax"] + PER_AXIS * n in facts and n < PER_AXIS]
        return ReadBack(curves=tuple(_read(facts, n) for n in sets))


def _divided(table: CompensationTable, axis: str, step: float, max_points: int) -> tuple[np.ndarray, float, list[int]]:
    """Division points (numbers from the reference point), the step between them, mm, and what each adds.

    The step is halved until no point exceeds a parameter's range. Raises GateError if none is small enough.
    """
    while True:
        step = float(np.ceil(step * 1e3 - 1e-6)) / 1e3
        at = _sample.around_zero(*_sample.span(table, axis), step)
        values = _rises(at, _sample.at_nodes(table, axis, axis, at * step))
        if max(map(abs, values)) <= LARGEST:
            return at, step, values
        if 2 * at.size > max_points:
            raise GateError(f"mitsubishi_pitch: {axis} rises by more than {LARGEST} half units from point to point")
        step /= 2


def _rises(at: np.ndarray, curve: Curve) -> list[int]:
    """What each point adds, half units; nothing at the reference point."""
    zero, mean = int(np.flatnonzero(at == 0)[0]), curve.mean
    rise = np.diff(np.round((mean - mean[zero]) / UNIT).astype(int))
    return [*rise[:zero].tolist(), 0, *rise[zero:].tolist()]


def _block(number: int, axis: str, first: int, step: float, at: np.ndarray, values: list[int]) -> list[str]:
    zero = int(np.flatnonzero(at == 0)[0])
    facts = {
        "cmpax": axis,
        "drcax": axis,
        "rdvno": first + zero,
        "mdvno": first,
        "pdvno": first + at.size - 1,
        "sc": 1,
        "spcdv": round(step * 1e3),
    }
    lines = [f"#{KEYS[key] + PER_AXIS * number} = {value}  # {key}" for key, value in facts.items()]
    return lines + [f"#{FIRST + first + k} = {value}" for k, value in enumerate(values)]


def _read(facts: Mapping[int, str], number: int) -> Curve:
    """Sums outwards from the reference point, as the control makes them."""
    try:
        axis, reference, lowest, highest, step = (
            facts[KEYS[k] + PER_AXIS * number] for k in ("cmpax", "rdvno", "mdvno", "pdvno", "spcdv")
        )
        values = np.array([int(facts[FIRST + n]) for n in range(int(lowest), int(highest) + 1)])
    except KeyError as err:
        raise VerifyError(f"{FILE}: parameter {err} is missing") from None
    zero = int(reference) - int(lowest)
    above, below = np.cumsum(values[zero + 1 :]), np.cumsum(values[:zero][::-1])[::-1]
    value = np.concatenate((-below, [0], above)) * UNIT
    return Curve(axis, axis, (np.arange(values.size) - zero) * int(step) * 1e-3, value, value)
