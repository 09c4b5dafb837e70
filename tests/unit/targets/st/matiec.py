"""The exported blocks through MATIEC (iec2c), a compiler of IEC 61131-3, as a shared library with the tests' session.

MATIEC is GPL, in no package index, and not needed: `IEC2C=/path/to/iec2c` (its folder holds `lib/`) switches these on.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

# The blocks are called through a program, so that MATIEC sees every call it has to pass arguments for.
PROGRAM = """
PROGRAM MAIN
VAR
    fbStore : FB_EctStore;
    fbCycle : FB_EctCycle;
    aFile : ECT_FILE;
    nFile : DINT;
    bNew : BOOL;
    nOnly : DWORD;
    stFirst : ECT_TABLE;
    stSecond : ECT_TABLE;
END_VAR
VAR RETAIN
    aGood : ECT_FILE;
    nGood : DINT;
END_VAR
    fbStore(bNew := bNew, nOnly := nOnly, aFile := aFile, nFile := nFile, aGood := aGood, nGood := nGood,
            stFirst := stFirst, stSecond := stSecond);
END_PROGRAM
CONFIGURATION C
    RESOURCE R ON PLC
        TASK T(INTERVAL := T#1ms, PRIORITY := 1);
        PROGRAM P WITH T : MAIN;
    END_RESOURCE
END_CONFIGURATION
"""
# VAR_IN_OUT are copies in MATIEC's C: the table goes into the cycle's copy when it changes, not in every cycle.
HARNESS = """
#include <stdlib.h>
#include <string.h>
#include "iec_std_lib.h"
#include "accessor.h"
#include "POUS.h"
TIME __CURRENT_TIME; BOOL __DEBUG = 0;
#include "POUS.c"
static MAIN plc;
static int give(const unsigned char *data, size_t size, int news, unsigned int only)
{
    memset(&plc.AFILE.value, 0, sizeof plc.AFILE.value);
    memcpy(&plc.AFILE.value, data, size);
    plc.NFILE.value = (DINT)size;
    plc.NONLY.value = only;
    plc.BNEW.value = 0;
    if (news) { MAIN_body__(&plc); plc.BNEW.value = 1; }
    MAIN_body__(&plc);
    if (plc.FBSTORE.NACTIVE.value == 1) plc.FBCYCLE.STTABLE.value = plc.STFIRST.value;
    if (plc.FBSTORE.NACTIVE.value == 2) plc.FBCYCLE.STTABLE.value = plc.STSECOND.value;
    return plc.FBSTORE.NERROR.value;
}
int keep(const unsigned char *data, size_t size, int news, unsigned int only) { return give(data, size, news, only); }
unsigned int running(void)
{
    int n = plc.FBSTORE.NACTIVE.value;
    return n == 1 ? plc.STFIRST.value.NNAME : n == 2 ? plc.STSECOND.value.NNAME : 0;
}
void power_loss(void) /* VAR RETAIN is all that stays; MATIEC marks its numbers, not its arrays */
{
    static __IEC_ECT_FILE_t_OR_ARRAY good; DINT size = plc.NGOOD.value;
    memcpy(&good, &plc.AGOOD.value, sizeof good);
    int marked = plc.NGOOD.flags & __IEC_RETAIN_FLAG;
    memset(&plc, 0, sizeof plc);
    MAIN_init__(&plc, 0);
    if (marked) { memcpy(&plc.AGOOD.value, &good, sizeof good); plc.NGOOD.value = size; }
}
void spoil(size_t at) { ((unsigned char *)plc.AGOOD.value.table)[at] ^= 4; }
void *session_open(const unsigned char *data, size_t size)
{
    memset(&plc, 0, sizeof plc);
    MAIN_init__(&plc, 0);
    return give(data, size, 0, 0) == 0 ? &plc : 0;
}
int session_reload(void *s, const unsigned char *data, size_t size) { (void)s; return give(data, size, 1, 0) == 0; }
void session_reset(void *s) { (void)s; plc.FBCYCLE.BRESET.value = 1; }
void session_close(void *s) { (void)s; }
void session_run(void *s, size_t cycles, const double *given, const unsigned char *news, const unsigned char *mode,
                 double *c, unsigned int *status)
{
    FB_ECTCYCLE *own = &plc.FBCYCLE;
    size_t k;
    int i, inputs = own->STTABLE.value.NINPUTS, outputs = own->STTABLE.value.NOUTPUTS;
    (void)s;
    for (k = 0; k < cycles; k++) {
        for (i = 0; i < inputs; i++) {
            own->AFREADING.value.table[i] = given[k * (size_t)inputs + (size_t)i];
            own->ABFRESH.value.table[i] = news[k * (size_t)inputs + (size_t)i];
        }
        own->BENABLE.value = mode[k] == 1;
        own->BHOLD.value = mode[k] == 2;
        FB_ECTCYCLE_body__(own);
        own->BRESET.value = 0;
        for (i = 0; i < outputs; i++) c[k * (size_t)outputs + (size_t)i] = own->AFCORRECTION.value.table[i];
        status[k] = (unsigned int)own->NSTATUS.value;
    }
}
"""


def compiler() -> Path | None:
    """iec2c, where there is one with its library beside it."""
    value = os.environ.get("IEC2C") or shutil.which("iec2c")
    return Path(value).resolve() if value and (Path(value).resolve().parent / "lib").is_dir() else None


def build(folder: Path, units: list[str]) -> Path:
    """A shared library of the blocks as MATIEC compiles them."""
    own = compiler()
    assert own is not None
    (folder / "all.st").write_text("\n".join(units) + PROGRAM)
    made = subprocess.run(
        [own, "-I", own.parent / "lib", "-T", folder, folder / "all.st"], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stdout + made.stderr
    bytes_type = next(line.split("(")[1].split(",")[0] for line in (folder / "POUS.h").open() if "_OF_BYTE_" in line)
    (folder / "plc.c").write_text(HARNESS.replace("__IEC_ECT_FILE_t_OR_ARRAY", bytes_type))
    flags = [
        "-O2",
        "-ffp-contract=off",
        "-fwrapv",
        "-w",
        "-shared",
        "-fPIC",
        "-I",
        own.parent / "lib" / "C",
        "-I",
        folder,
    ]
    subprocess.run(["gcc", *flags, folder / "plc.c", "-o", folder / "plc.so", "-lm"], check=True)
    return folder / "plc.so"
