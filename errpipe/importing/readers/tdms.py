"""LabVIEW and NI DIAdem files (.tdms), by npTDMS (extra `tdms`, LGPL). A group is a sheet, a channel a column."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from errpipe.errors import UsageError
from errpipe.importing.sheet import ReaderOptions, Sheet, readable

name = "TDMS"
suffixes = (".tdms",)
binary = True


def sniff(path: Path, head: bytes) -> bool:
    """The lead-in of a TDMS segment."""
    return head.startswith(b"TDSm")


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """Channels of each group, with a time column if the channels state their increment. Raises DataError."""
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError:
        raise UsageError(f"{path}: reading TDMS needs npTDMS: pip install 'errpipe[tdms]'") from None
    remarks: dict[str, None] = {}  # log messages of npTDMS become notes of the import, once each

    def keep(record: logging.LogRecord) -> bool:
        return remarks.setdefault(record.getMessage()) is not None

    log_manager.console_handler.addFilter(keep)
    try:
        with readable(path, "a TDMS file"):
            file = TdmsFile.read(str(path))
            groups = [g for g in file.groups() if options.sheet in (None, g.name) and g.channels()]
            sheets = [_sheet(group).limited() for group in groups]
    finally:
        log_manager.console_handler.removeFilter(keep)
    return [replace(sheet, notes=[*sheet.notes, *remarks]) for sheet in sheets]


def _sheet(group) -> Sheet:
    """The channels of a group as columns; those sampled differently from the longest are resampled at its times."""
    header, columns, notes = [], [], []
    channels = group.channels()
    base = max(channels, key=len)
    times = _times(base)
    for channel in channels:
        values = np.asarray(channel[:])
        unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription")
        header.append(f"{channel.name} [{unit}]" if unit else channel.name)
        if values.dtype.kind == "M":
            values = (values - values[0]) / np.timedelta64(1, "s")
            header[-1] = f"{channel.name} [s]"
        elif values.dtype.kind not in "iufb":
            columns.append([str(v) for v in values])
            continue
        own = _times(channel)
        if times is not None and own is not None and values.size and not np.array_equal(own, times):
            notes.append(f"{channel.name}: sampled at other times than {base.name}: interpolated")
            held = times <= own[-1] + (own[-1] - own[0]) / max(len(own) - 1, 1)  # the last value is held for one step
            values = np.where(held, np.interp(times, own, values, left=np.nan), np.nan)
        columns.append(np.asarray(values, dtype=float).tolist())
    length = max(map(len, columns), default=0)
    if times is not None and not any(h.lower().startswith("time") for h in header):
        header.insert(0, "time [s]")
        columns.insert(0, (times - times[0]).tolist())
    rows: list[list[str | float | None]] = [[c[i] if i < len(c) else None for c in columns] for i in range(length)]
    return Sheet(group.name, rows, header, notes)


def _times(channel) -> np.ndarray | None:
    """s, of every sample of a channel that states its increment; from the start of 1970 if it states its start."""
    step = channel.properties.get("wf_increment")
    if not step:
        return None
    start = channel.properties.get("wf_start_time")
    begin = (np.datetime64(start, "us") - np.datetime64(0, "us")) / np.timedelta64(1, "s") if start is not None else 0.0
    offset = float(channel.properties.get("wf_start_offset") or 0.0)
    return float(begin) + offset + float(step) * np.arange(len(channel))
