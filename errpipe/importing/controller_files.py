"""Compensation files of controllers submitted as measurements: identified, and refused.

A controller's file contains what the control adds or subtracts, not what an axis did; taken as deviations it doubles
the error, or corrects a machine that is already corrected.
"""

from __future__ import annotations

import re
from pathlib import Path

ECT = b"ECT\x00"  # a table of errpipe itself (schemas/ect-2.md)

# What a file's text contains -> what the file is, and how to deactivate it in the control (none: see its manual).
_BY_TEXT: tuple[tuple[str, ...], ...] = (
    (
        r"\$AA_ENC_COMP|_EEC_INI",
        "the leadscrew error compensation ($AA_ENC_COMP) of a SINUMERIK",
        "MD32700 $MA_ENC_COMP_ENABLE = 0",
    ),
    (r"\$A[AN]_CEC|_CEC_INI", "the sag compensation ($AN_CEC) of a SINUMERIK", "MD32710 $MA_CEC_ENABLE = 0"),
    (r"\$AA_QEC|_QEC_INI", "the quadrant error compensation ($AA_QEC) of a SINUMERIK"),
    (r"\$SA_TEMP_COMP", "the temperature compensation of a SINUMERIK", "MD32750 $MA_TEMP_COMP_TYPE = 0"),
    (r"^BEGIN \S+\.(COM|CMA)\b", "a compensation table (.COM, listed in CONFIG.CMA) of a HEIDENHAIN TNC"),
    (
        r"^N0*362[0-7](\b|Q)|(^N1\d{4} ?(Q\d+)? ?P-?\d+;?\s*){3}",
        "parameters of a FANUC control with its stored pitch error compensation (No. 3620 to 3627, data from 10000)",
    ),
    (
        r"(^#4[01]\d\d\s*=.*\s*){3}|^N4\d{3}.*MACHINE ERROR",
        "machine error compensation parameters of a MITSUBISHI control",
    ),
    (r"^:START(1D|2D|3D)?\b.*\b(MASTER|REFAXIS|OUTAXIS|SLAVE)\b", "a calibration file (.cal) of an Aerotech control"),
    (r"\bDEFINE (BL|T)?COMP\b", "a compensation table (DEFINE COMP) of a PMAC", "I51 = 0"),
    (r"^kw\.\w+|^kopf\.achs_nr", "axis compensation values (kw. ...) of a TwinCAT or ISG CNC"),
    (r"ST_PositionCompensationTable", "a position compensation table of TwinCAT NC"),
    (r"^\[[XYZABC][+-]\]\s*$[\s\S]*^Error0\s*=", "a screw map of Mach4"),
    (
        r"^(#\*# )?\[(bed_mesh|axis_twist_compensation|skew_correction)\b",
        "a configuration of Klipper with compensations",
    ),
    (r"^RepRapFirmware height map", "a height map of RepRapFirmware", "G29 S2"),
    (r"^M421 I\d", "a mesh (M421) of Marlin", "M420 S0"),
    (
        r"\b(pitch error|lead ?screw|machine error) (comp\w*\.? (data|table|parameters?)\b|comp\w*\))"
        r"|\bPARAMETER PITCH ERROR\b",
        "the pitch error compensation of a control",
    ),
)
_BY_NAME: tuple[tuple[str, ...], ...] = (
    (r".*\.comp", "a screw compensation (COMP_FILE) of LinuxCNC", "COMP_FILE taken out of the INI file"),
    (r".*\.hal", "wiring (HALFILE) of LinuxCNC", "COMP_FILE and HALFILE of the compensation taken out of the INI file"),
    (r"screw_?map.*\.(dat|txt|csv)", "a screw map of Mach3 or Mach4"),
    (r"axeserr.*\.dat", "a screw error file of a Weihong control"),
    (r"lscrw.*", "a leadscrew table of a FAGOR control"),
    (r"leadscrew.*\.txt", "a leadscrew compensation of a HAAS control"),
    (r"pitch_compensation\.dat", "a pitch compensation of Smoothieware"),
)


def controller_file_kind(path: Path, head: bytes) -> str | None:
    """The message for a compensation file of a control, with the alternative; None for any other file."""
    if head.startswith(ECT):
        return (
            "a compensation table of errpipe, not a measurement: import only the deviations measured with it "
            "active, and declare it as `compensated_by` in the stage ingest"
        )
    text = head.replace(b"\0", b"").decode("latin-1").replace("\r\n", "\n")
    kinds = [k for k in _BY_TEXT if re.search(k[0], text, re.IGNORECASE | re.MULTILINE)]
    kinds += [k for k in _BY_NAME if re.fullmatch(k[0], path.name, re.IGNORECASE)]
    if not kinds:
        return None
    _, what, *more = kinds[0]
    off = more[0] if more else "as the manual of the control describes"
    return (
        f"{what}: what the control adds or subtracts, not a measurement. Import the deviations measured with it "
        f"switched off ({off}); if it was active, they are only its "
        "residual, and the new table is added to it"
    )
