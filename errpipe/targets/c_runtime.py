"""C99 for a controller of one's own: the runtime (one header, one source) and the table as an array of bytes.

Value     `ect_correction(&e, i)` in the output's unit (mm), to be added to the command: minus the deviation; 0 where no
          table runs.
Files     ect.h, ect.c (the same for every table), table.h/table.c (the bytes), example.c (a cycle, to copy from).
Compile   -std=c99 -ffp-contract=off; -DECT_SINGLE where there is no double. No allocation, no C library but memcpy.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping

from errpipe.domain.table import CompensationTable
from errpipe.tables import ect
from errpipe.targets._base import ReadBack, Target
from errpipe.targets._text import c_array, plain, source
from errpipe.targets._whole import WholeTable

RUNTIME = ("ect.h", "ect.c", "ect_identity.h", "ect_identity.c")


class CRuntime(Target):
    """The whole table for a controller programmed in C."""

    name = "c_runtime"
    controller = "any with a C99 compiler"
    confidence = "verified"
    sign = "a positive correction is added to the command: it moves the axis in plus"
    limits = "whole table; single precision loses a few nanometres"
    unit = "as table.h names each input and output: mm (deg) unless the table says otherwise"
    holds = ("screw", "both directions", "cross", "temperature")
    remark = {"table.h": "/* {} */"}
    source = "schemas/ect-2.md; compiled and compared to the bit in the tests, on a Cortex-M in an emulator too"
    activation = (
        "ect_load_only refuses every table but the one whose SHA-256 may run here (ECT_TABLE_IDENTITY in table.h); a "
        "signature is checked before the table is brought to the controller (`minisign -V`), not by the runtime",
        "ect_load must return ECT_OK; e.crc shows the table's checksum: compare it with `errpipe whatis table.ect`",
        "emergency stop or drives without power: mode ECT_HOLD; before and while homing: ECT_OFF",
        "call ect_cycle once per position cycle; bit 0 of e.status must be set and e.heartbeat must count",
        "read ect_correction at three points with ECT_OFF (all 0) and ECT_ON before adding it to a command",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        files, data = {name: source("tables/runtime", name) for name in RUNTIME}, ect.dumps(table)
        files |= {"table.h": _header(table, data), "table.c": c_array("table.h", "ect_table", data)}
        return files | {"example.c": _example(table)}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        return WholeTable.from_array(cls, files, "table.c", "ect_table")


def _macro(kind: str, name: str) -> str:
    return f"ECT_{kind}_" + re.sub(r"[^A-Z0-9]", "_", name.upper())


def _header(table: CompensationTable, data: bytes) -> str:
    rows = [(_macro("IN", i.name), n, f"{i.name}, {i.unit or '-'}") for n, i in enumerate(table.inputs)]
    rows += [(_macro("OUT", o.name), n, f"{o.name}, {o.correction_unit}") for n, o in enumerate(table.outputs)]
    identity = ", ".join(f"0x{b:02x}" for b in hashlib.sha256(data).digest())
    taken: set[str] = set()
    lines = []
    for macro, number, what in rows:
        while macro in taken:
            macro += "_"
        taken.add(macro)
        lines.append(f"#define {macro} {number} /* {plain(what)} */")
    return (
        f"/* Table {ect.fingerprint(table)}: {plain(table.machine)} {plain(table.title)} */\n"
        "#ifndef ECT_TABLE_H\n#define ECT_TABLE_H\n\n#include <stdint.h>\n\n"
        f"#define ECT_TABLE_SIZE {len(data)}\n"
        f"#define ECT_CYCLE_S {table.position_cycle_s!r}\n"
        f"/* SHA-256 of ect_table */\n#define ECT_TABLE_IDENTITY {{{identity}}}\n"
        + "\n".join(lines)
        + "\n\nextern const uint8_t ect_table[ECT_TABLE_SIZE];\n\n#endif\n"
    )


def _example(table: CompensationTable) -> str:
    readings = ", ".join(f"(ect_real){i.default!r}" for i in table.inputs) or "0"
    return f"""/* One cycle: replace the readings by your axes and sensors, and add the corrections to your commands. */
#include <stdio.h>

#include "ect.h"
#include "ect_identity.h"
#include "table.h"

/* What this machine may run; a table from elsewhere (a file, a flash page) is held against it in the same way. */
static const uint8_t allowed[ECT_IDENTITY_SIZE] = ECT_TABLE_IDENTITY;
static uint64_t work[1u << 16]; /* ect_work_size() says how much of it is needed */

int main(void)
{{
    static const ect_real readings[] = {{{readings}}};
    ect e;
    uint32_t o;
    ect_error error;
    error = ect_load_only(&e, ect_table, ECT_TABLE_SIZE, work, sizeof work, allowed);
    if (error != ECT_OK) {{
        printf("refused: %s (record %u)\\n", ect_says(error), (unsigned)e.where);
        return 1;
    }}
    ect_cycle(&e, readings, NULL, ECT_ON);
    for (o = 0; o < e.output_count; o++) {{
        printf("%u %.9g\\n", (unsigned)o, (double)ect_correction(&e, o));
    }}
    return 0;
}}
"""
