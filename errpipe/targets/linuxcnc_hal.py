"""LinuxCNC HAL component: the whole table and its C runtime in one `.comp` file, with HAL files that connect it.

Value     `errpipe.correction-L` in mm (deg), ADDED to the command of axis L (minus the deviation).
Ways      errpipe-joints.hal adds it to the joints' motor commands; errpipe-origin-shift.hal hands it over as external
          offsets (`axis.L.eoffset-counts`), the origin-shift method of 1997.
Pins      one `in-NAME` per input of the table, `fault-NAME` and `rejected-NAME` (refused for their rate) next to it,
          `enable` (FALSE holds the corrections: emergency stop), `homed`, `off`, `status`, `heartbeat`, `wrong-rate`;
          the sums are made inside (no sum2, which a machine's own HAL file may have loaded: that works only once).
Traps     an unconnected pin reads 1e31, which is a missing reading, not 0; a thread at another rate than the table's
          raises wrong-rate and leaves the corrections at 0; machine units are mm (LINEAR_UNITS = mm), else
          LinuxCNC does not start with these HAL files: "program 'expr' failed".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from errpipe.domain import table as t
from errpipe.errors import GateError
from errpipe.tables import ect
from errpipe.targets import _sample
from errpipe.targets._base import HOMED_AT_ONCE, ByHand, ReadBack, Target, expect, matched
from errpipe.targets._text import filled, plain, source
from errpipe.targets._whole import WholeTable

COMPONENT = "errpipe.comp"
JOINTS = "errpipe-joints.hal"
SHIFT = "errpipe-origin-shift.hal"
THREAD = "servo-thread"
AXES = "X Y Z A B C U V W"  # of LinuxCNC, the L of axis.L.eoffset-counts
COUNT_SIZE = "0.0001"  # mm per count of an external offset
MAX_TABLE_BYTES = 1 << 20  # of a table as C source: more takes the compiler too long
MAX_PIN_LENGTH = 24  # of HAL's 47 characters, with room for the component's name and a prefix
_TABLE = re.compile(r"errpipe_table\[(\d+)\][^{]*\{([^}]*)\}")


class LinuxcncHal(Target):
    """Everything a table can say, once per servo cycle, for LinuxCNC 2.8 and newer."""

    name = "linuxcnc_hal"
    controller = "LinuxCNC"
    confidence = "verified"
    sign = "a positive value moves the joint further in plus"
    limits = "nothing is lost; machine units mm; the servo thread must run at the table's position cycle"
    holds = ("screw", "both directions", "cross", "temperature")
    remark = {".hal": "# {}"}
    numbering = "joint {0}"
    source = "LinuxCNC: docs hal/comp, config/ini-config (OFFSET_AV_RATIO), man motion (axis.L.eoffset)"
    activation = (
        "halcompile --install errpipe.comp (package linuxcnc-uspace-dev)",
        "[EMCMOT] SERVO_PERIOD = the table's position cycle in ns",
        f"[HAL] HALFILE = {JOINTS} after the machine's own, its DRIVE lines connected; or {SHIFT} instead, with "
        "[AXIS_L] OFFSET_AV_RATIO = 0.1",
        "no COMP_FILE for the same joint: both would be added",
        "halcmd getp errpipe.table-crc is the table's checksum; errpipe.heartbeat grows; errpipe.wrong-rate is FALSE",
        "halcmd getp errpipe.fault-NAME of every sensor is 0 two seconds after the start",
        HOMED_AT_ONCE,
        "halcmd getp errpipe.tmax (CPU clocks) is small against the period",
    )

    @classmethod
    def write(cls, table: t.CompensationTable) -> dict[str, str]:
        _sample.moved_axes(table, cls.name)
        data = ect.dumps(table)
        if len(data) > MAX_TABLE_BYTES:
            raise GateError(
                f"linuxcnc_hal: the table has {len(data)} bytes (at most {MAX_TABLE_BYTES}); allow a larger error_bound"
            )
        facts = _facts(table, data)
        files = {
            COMPONENT: filled("errpipe.comp.j2", facts | _source(data)),
            JOINTS: filled("errpipe-joints.hal.j2", facts),
        }
        return files if _of_joints_only(table) else files | {SHIFT: filled("errpipe-origin-shift.hal.j2", facts)}

    @classmethod
    def by_hand(cls, table: t.CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        no_backlash = tuple(
            ByHand(f"[JOINT_n] of {axis}: no BACKLASH (the table holds both directions)")
            for axis in _sample.lost_motion(table)
        )
        joints = ", ".join(_of_joints_only(table))
        why = f"no {SHIFT} was written: LinuxCNC offsets whole axes ({AXES}), and the table corrects {joints}"
        return no_backlash + ((ByHand(why),) if joints else ())

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> WholeTable:
        match = matched(_TABLE, files[COMPONENT], COMPONENT, "holds no whole table")
        expect(files[COMPONENT].rstrip().endswith("}"), COMPONENT, "holds no whole table")
        data = bytes(int(v, 16) for v in re.findall(r"0x([0-9a-f]{2})", match[2]))
        expect(len(data) == int(match[1]), COMPONENT, f"{len(data)} bytes of table where {match[1]} are announced")
        table = ect.loads(data)
        return WholeTable.of(table)


def _of_joints_only(table: t.CompensationTable) -> list[str]:
    """Corrected drives that are no axis of LinuxCNC, such as both of a gantry (X1, X2): `axis.x1` does not exist."""
    return [axis for axis in _sample.outputs_by_axis(table) if axis not in AXES.split()]


def _facts(table: t.CompensationTable, data: bytes) -> dict[str, Any]:
    """What the templates need to know of a table."""
    inputs = _input_pins(table)
    outputs = _output_pins(table)
    letters = {p["axis"]: p for p in outputs if p["axis"]}
    joint = {letter: n for n, letter in enumerate(_sample.axes_of(table))}
    pins = {p["input"]: p for p in inputs}
    return {
        "machine": plain(table.machine),
        "version": plain(table.version),
        "crc": ect.fingerprint(table),
        "crc_number": int(ect.fingerprint(table), 16),
        "period_ns": round(table.position_cycle_s * 1e9),
        "counted": " ".join(joint),
        "bits": ", ".join(f"{n} {name}" for n, name in enumerate(t.STATUS)),
        "thread": THREAD,
        "count_size": COUNT_SIZE,
        "inputs": inputs,
        "outputs": outputs,
        "room": _work_area(table),
        "positions": [
            {"letter": letter.lower(), "joint": joint[letter], "pin": f"errpipe.{hal(pins[name]['name'])}"}
            for letter, name in _sample.positions_of(table).items()
        ],
        "joints": [
            {
                "letter": letter.lower(),
                "joint": joint[letter],
                "pin": hal(p["short"]),
                "read": letter in _sample.positions_of(table),
            }
            for letter, p in letters.items()
        ],
        "others": _other_lines(table, pins),
    }


def _input_pins(table: t.CompensationTable) -> list[dict[str, Any]]:
    taken: set[str] = set()
    pins = []
    for i in table.inputs:
        short = _identifier(i.name, taken)
        unit = f", {plain(i.unit)}" if i.unit else ""
        pins.append(
            {
                "input": i.name,
                "what": plain(i.name),
                "name": f"in_{short}",
                "fresh": f"fresh_{short}",
                "fault": f"fault_{short}",
                "rejected": f"rejected_{short}",
                "stale": i.stale_after_s is not None,
                "place": i.kind == "position",
                "text": f"{plain(i.name)}: {i.kind}{unit}",
            }
        )
    return pins


def _output_pins(table: t.CompensationTable) -> list[dict[str, Any]]:
    """One pin per axis (the sum of its outputs), then one per output without an axis."""
    groups: dict[tuple[str, str], list[int]] = {}
    for n, output in enumerate(table.outputs):
        groups.setdefault((output.axis, "" if output.axis else output.name), []).append(n)
    taken: set[str] = set()
    pins = []
    for (axis, name), numbers in groups.items():
        short = _identifier(axis or name, taken)
        unit = table.outputs[numbers[0]].correction_unit
        text = f"{plain(axis or name)}: correction in {unit}, to be added to the command"
        pin = {"axis": axis, "short": short, "name": f"correction_{short}", "counts": "", "of": numbers, "text": text}
        if axis:
            pin |= {part: f"{part}_{short}" for part in ("counts", "planned", "command", "measured", "feedback")}
        pins.append(pin)
    return pins


def _other_lines(table: t.CompensationTable, pins: Mapping[str, dict[str, Any]]) -> list[str]:
    """How each further input is connected: what LinuxCNC knows is proposed, the rest is for the machine's builder."""
    lines = []
    for i in table.inputs:
        if i.kind == "position":
            continue
        pin = hal(pins[i.name]["name"])
        known = {"speed": "spindle.0.speed-out", "tool": "motion.tooloffset.z"}.get(i.kind, f"(your {i.kind} signal)")
        unit = f" in {plain(i.unit)}" if i.unit else ""
        lines.append(f"# INPUT: net errpipe-{pin} {known} => errpipe.{pin}    # {plain(i.name)}{unit}")
    return lines


def _work_area(table: t.CompensationTable) -> list[tuple[int, str]]:
    """Counts and C types of the runtime's work area, in the order in which it lays them out."""
    operands = sum(len(n.of) for n in table.nodes)
    lookups = sum(len(n.values) for n in table.nodes if isinstance(n, t.LookupNode))
    counts = (
        (len(table.inputs), "ect_input"),
        (sum(len(i.substitute) for i in table.inputs), "ect_weighted"),
        (len(table.nodes), "ect_node"),
        (operands, "ect_weighted"),
        (lookups, "ect_real"),
        (len(table.profiles), "ect_profile"),
        (len(table.components), "ect_real"),
        (len(table.pairs), "ect_pair"),
        (len(table.outputs), "ect_output"),
        (sum(len(o.terms) for o in table.outputs), "ect_term"),
        (len(table.nodes), "uint32_t"),
    )
    return [c for c in counts if c[0]]


def _source(data: bytes) -> dict[str, Any]:
    """The runtime without its own include, and the table's bytes as C."""
    header, runtime = (source("tables/runtime", name) for name in ("ect.h", "ect.c"))
    rows = [data[k : k + 20] for k in range(0, len(data), 20)]
    return {
        "header": header,
        "source": runtime.replace('#include "ect.h"\n', ""),
        "size": len(data),
        "bytes": "\n".join("    " + " ".join(f"0x{b:02x}," for b in row) for row in rows),
    }


def hal(name: str) -> str:
    """HAL's spelling of a component's identifier."""
    return name.replace("_", "-")


def _identifier(name: str, taken: set[str]) -> str:
    """Lower-case letters, digits and single underscores, unique among `taken`."""
    base = re.sub("_+", "_", re.sub("[^a-z0-9]", "_", name.lower())).strip("_")[:MAX_PIN_LENGTH].rstrip("_") or "pin"
    identifier, n = base, 2
    while identifier in taken:
        identifier, n = f"{base}_{n}", n + 1
    taken.add(identifier)
    return identifier
