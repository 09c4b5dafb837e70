"""Base of formats with one curve per axis over the axis' own position: screw maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from errpipe.domain.components import is_rotary
from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import ANOTHER_FORMAT, ByHand, Curve, ReadBack, Target


class ScrewMap(Target):
    """Base of the formats that hold screw maps: `file_of` writes one axis, `curve_of` reads one file."""

    max_points: ClassVar[int]  # points of one curve
    error_um: ClassVar[float]  # of interpolation, where so few points do
    linear_only: ClassVar[str] = ""  # why rotary axes are left out of the files
    turns_from_zero: ClassVar[bool] = False  # whether the control counts an axis that turns on from 0 to 360 deg

    @classmethod
    def own_axes(cls, table: CompensationTable) -> list[tuple[int, str]]:
        """(number, letter) of each axis that is corrected over its own position. Raises GateError without any."""
        lost_motion, corrected = _sample.positions_of(table), _sample.outputs_by_axis(table)
        axes = [(n, a) for n, a in enumerate(_sample.axes_of(table), 1) if a in lost_motion and a in corrected]
        if not axes:
            raise GateError(f"{cls.name}: no axis of the table is corrected over its own position")
        kept = [(n, a) for n, a in axes if not (cls.linear_only and is_rotary(a))]
        if not kept:
            raise GateError(f"{cls.name}: {' and '.join(a for _, a in axes)}: {cls.linear_only}: {ANOTHER_FORMAT}")
        return kept

    @classmethod
    def grid(cls, table: CompensationTable, axis: str) -> np.ndarray:
        """Equidistant positions of an axis' map: as few as the error allows."""
        grid = _sample.uniform(table, axis, axis, cls.max_points, cls.error_um)[0].positions()
        turned = cls.turns_from_zero and _sample.turns(table, axis)
        return np.linspace(0.0, _sample.TURN, grid.size) if turned else grid

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        files: dict[str, str] = {}
        for number, axis in cls.own_axes(table):
            name, text = cls.file_of(number, _sample.at_nodes(table, axis, axis, cls.grid(table, axis)))
            files[name] = files.get(name, "") + text
        return files

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        if "both directions" in cls.holds:
            lost: dict[str, float | None] = dict.fromkeys(c.axis for c in read.curves)
        else:
            lost_motion = _sample.lost_motion(table)
            lost = {axis: lost_motion.get(axis, 0.0) for _, axis in cls.own_axes(table)}
        parameter, held = "the control's backlash value", "= 0 (the file holds both)"
        return tuple(_sample.backlash_by_hand(table, a, f"{a}: {parameter}", value, held) for a, value in lost.items())

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        """(name, text) of the map of axis `number`; texts of one name are put behind each other."""
        raise TypeError(f"{cls.__name__} does not write")

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        return ReadBack(curves=tuple(cls.curve_of(name, text) for name, text in sorted(files.items())))

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        """The map in one file. Raises VerifyError if the controller would not take it."""
        raise TypeError(f"{cls.__name__} does not read back")
