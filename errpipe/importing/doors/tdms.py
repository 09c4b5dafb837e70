"""LabVIEW and NI DIAdem files (.tdms), by npTDMS (extra `tdms`, LGPL). A group is a sheet, a channel a column."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from errpipe.errors import DataError, UsageError
from errpipe.importing.sheet import DoorOptions, Sheet

name = "TDMS"
suffixes = (".tdms",)
binary = True


def sniff(path: Path, head: bytes) -> bool:
    """The lead-in of a TDMS segment."""
    return head.startswith(b"TDSm")


def read(path: Path, options: DoorOptions) -> list[Sheet]:
    """Channels of each group, with a time column where the channels state their increment. Raises DataError."""
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError:
        raise UsageError(f"{path}: reading TDMS needs npTDMS: pip install 'errpipe[tdms]'") from None
    remarks = _Remarks()
    log_manager.console_handler.addFilter(remarks.add)  # what it would print becomes a note of the import
    try:
        file = TdmsFile.read(str(path))
        groups = [g for g in file.groups() if options.sheet in (None, g.name) and g.channels()]
        sheets = [_sheet(group).limited() for group in groups]
        return [replace(sheet, notes=[*sheet.notes, *remarks.said]) for sheet in sheets]
    except (DataError, MemoryError):
        raise
    except Exception as err:  # npTDMS raises ValueError, struct.error, KeyError, ... for damaged files
        raise DataError(f"{path}: not a TDMS file that can be read ({type(err).__name__})") from None
    finally:
        log_manager.console_handler.removeFilter(remarks.add)


class _Remarks:
    """What npTDMS says of a file, such as that its last segment is cut, once each."""

    def __init__(self) -> None:
        self.said: dict[str, None] = {}

    def add(self, record: logging.LogRecord) -> bool:
        self.said[record.getMessage()] = None
        return False


def _sheet(group) -> Sheet:
    header, columns = [], []
    step = group.channels()[0].properties.get("wf_increment")
    for channel in group.channels():
        values = np.asarray(channel[:])
        if values.dtype.kind == "M":
            values = (values - values[0]) / np.timedelta64(1, "s")
            header.append(f"{channel.name} [s]")
        elif values.dtype.kind not in "iufb":
            header.append(channel.name)
            columns.append([str(v) for v in values])
            continue
        else:
            unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription")
            header.append(f"{channel.name} [{unit}]" if unit else channel.name)
        columns.append(np.asarray(values, dtype=float).tolist())
    length = max(map(len, columns), default=0)
    if step and not any(h.lower().startswith("time") for h in header):
        header.insert(0, "time [s]")
        columns.insert(0, (float(step) * np.arange(length)).tolist())
    rows: list[list[str | float | None]] = [[c[i] if i < len(c) else None for c in columns] for i in range(length)]
    return Sheet(group.name, rows, header)
