"""Feedback interception: counts added to the encoder's signal to the controller, so that its position loop corrects.

Value     counts = -correction x counts per mm, rounded: where the axis must go 10 um less far, the controller is
          shown 10 um more than the encoder reads. Its own loop moves the axis; nothing in the controller is changed.
Files     errpipe_inject.comp and errpipe-inject.hal for LinuxCNC, between a (simulated) encoder and `encoder`, fed by
          the correction pins of the HAL component of the whole table; for a microcontroller the freestanding core
          feedback_inject.h/.c beside the table's runtime ect.h/.c and its bytes inject_table.h/.c.
Rules     one edge a base period; the index passed unshifted; nothing injected before it; frozen, never taken away, on
          an emergency stop; a tenth of the largest count rate at most; illegal transitions of the encoder counted.
Direction from the command (the HAL files feed the table from joint.N.pos-cmd). Where only the encoder knows it, from
          inject_travel with a threshold above the lost motion and several counts: with a threshold of one count a
          trial saw it turn 1253 times at rest.
"""

from __future__ import annotations

from collections.abc import Mapping

from errpipe.domain.table import CompensationTable
from errpipe.tables import ect
from errpipe.targets import _sample
from errpipe.targets._base import HOMED_AT_ONCE, ReadBack, Target
from errpipe.targets._text import c_array, filled, plain, source
from errpipe.targets._whole import WholeTable

COMPONENT, WIRING = "errpipe_inject.comp", "errpipe-inject.hal"
TABLE, TABLE_HEADER = "inject_table.c", "inject_table.h"
CORE = ("feedback_inject.h", "feedback_inject.c")
MIN_LIMIT = 0.001  # mm (deg): of the largest correction that the component takes


class FeedbackInject(Target):
    """The whole table, acting through the encoder's signal instead of the command."""

    name = "feedback_inject"
    controller = "any with a quadrature encoder (LinuxCNC, or a microcontroller in the cable)"
    confidence = "verified"
    sign = "a positive correction takes counts off what the controller sees, so the loop moves the axis in plus"
    limits = (
        "whole counts; quadrature A, B, Z with an index; a tenth of the count rate; whole table, evaluated in parallel"
    )
    unit = "encoder counts: the correction in mm or deg times the scale that is filled in"
    holds = ("screw", "both directions", "cross", "temperature")
    remark = {"inject_table.c": "/* {} */"}
    source = "quadrature as LinuxCNC's encoder counts it (A first counts up); proved in C and in LinuxCNC by the tests"
    activation = (
        "LinuxCNC: install the HAL component of the whole table and errpipe_inject.comp by halcompile; "
        "take its position and INPUT lines over, NOT its lines for joints: the command must not be corrected as well",
        "errpipe-inject.hal: fill in scale (as of the counter), max-velocity, base-period; refused must be FALSE",
        "move by hand: counts must count like the counter's rawcounts, sign included; else scale is wrong",
        "home: found turns TRUE at the index; injected must follow aim; illegal must stay 0",
        HOMED_AT_ONCE,
        "microcontroller: inject_fits for the largest speed and the step's period; inject_side_fits for its threshold",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        by_axis = _sample.moved_axes(table, cls.name)
        sums = [sum((o.magnitude or 0.0) * o.factor for o in outputs) for outputs in by_axis.values()]
        header, core = (source("targets/inject", name) for name in CORE)
        facts = {
            "header": header,
            "source": core.replace('#include "feedback_inject.h"\n', ""),
            "most": f"{max(MIN_LIMIT, *sums):.6f}",
            "axes": [{"letter": axis.lower(), "number": n} for n, axis in enumerate(by_axis)],
            "crc": ect.fingerprint(table),
            "names": ",".join(f"errpipe-inject.{axis.lower()}" for axis in by_axis),
        }
        files = dict(zip(CORE, (header, core), strict=True))
        files |= {name: source("tables/runtime", name) for name in ("ect.h", "ect.c")}
        files[COMPONENT] = filled("errpipe-inject.comp.j2", facts)
        files[WIRING] = filled("errpipe-inject.hal.j2", facts)
        data = ect.dumps(table)
        files[TABLE] = c_array(TABLE_HEADER, "inject_table", data)
        files[TABLE_HEADER] = _header(table, len(data))
        return files

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        return WholeTable.from_array(cls, files, TABLE, "inject_table")


def _header(table: CompensationTable, size: int) -> str:
    lost = _sample.lost_motion(table)
    lines = [
        f"#define INJECT_LOST_MOTION_UM_{axis} {1e3 * abs(lost.get(axis, 0.0)):.3f} "
        "/* a direction's threshold: this and several counts */"
        for axis in _sample.outputs_by_axis(table)
    ]
    return (
        f"/* Table {ect.fingerprint(table)}: {plain(table.machine)} {plain(table.title)}; ect_load takes it, and\n"
        " * inject_aim the outputs' corrections times minus the counts per mm, rounded. */\n"
        "#ifndef INJECT_TABLE_H\n#define INJECT_TABLE_H\n\n#include <stdint.h>\n\n"
        f"#define INJECT_TABLE_SIZE {size}\n"
        + "\n".join(lines)
        + "\n\nextern const uint8_t inject_table[INJECT_TABLE_SIZE];\n\n#endif\n"
    )
