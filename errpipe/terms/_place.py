"""Where a response lives: which axis it belongs to, and how an axis' own deviation shows in it.

A positioning deviation (`EXX`) or a tool-point deviation (`E_X`) holds an axis' deviation in full; the
radial deviation of a circular test (`E_R`) holds x/R of it, counted from the circle's centre.
"""

from __future__ import annotations

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.terms._base import position


def own_axis(component: str) -> str | None:
    """The axis a component belongs to: X of EXX, EYX, EAX; None for tool-point, radial and size components."""
    if len(component) == 3 and component[0] == "E" and component[1] != "_" and component[2].isalpha():
        return component[2]
    return None


def direction_of(component: str) -> str | None:
    """The direction a linear deviation points in: Y of EYX, X of E_X; None for angles, E_R, E_D and forces."""
    if len(component) == 3 and component[0] == "E":
        letter = component[2] if component[1] == "_" else component[1]
        return letter if letter in "XYZUVW" else None
    return None


def is_radial(component: str) -> bool:
    """Is it the radial deviation of a circular test?"""
    return component == "E_R"


def axes(recording: Recording, kind: str = "linear") -> tuple[str, ...]:
    """Axes whose position (or command) is recorded, in manifest order."""
    found: list[str] = []
    for name in (*recording.names("position"), *recording.names("command")):
        letter = str(recording.manifest.columns[name].axis)
        known = recording.manifest.axis(letter)
        if letter not in found and ((known.kind if known else None) or "linear") == kind:
            found.append(letter)
    return tuple(found)


def axes_acting(recording: Recording, component: str) -> tuple[str, ...]:
    """Axes whose own deviation along themselves shows in a component: X in EXX and E_X, all of the circle in E_R."""
    present = axes(recording) + axes(recording, "rotary")
    if is_radial(component):
        return axes(recording)[:2]
    if component.startswith("E") and len(component) == 3:
        own = own_axis(component) or component[2]
        if direction_of(component) in (own, None):
            return (own,) if own in present else ()
    return ()


def position_name(recording: Recording, axis: str) -> str:
    """Name of the column with an axis' position, else its command."""
    name = recording.name("position", axis=axis) or recording.name("command", axis=axis)
    if name is None:
        raise KeyError(f"the recording has no position of axis {axis}")
    return name


def travel(recording: Recording, axis: str) -> tuple[float, float]:
    """Travel of an axis in mm (deg): from the constants, else the range its positions cover."""
    known = recording.manifest.axis(axis)
    if known is not None and known.travel is not None:
        return known.travel
    x = position(recording, axis)
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    return (low, high) if high > low else (low, low + 1.0)


def share(recording: Recording, axis: str, radial: bool) -> np.ndarray:
    """How much of an axis' own deviation shows in the response, shape (rows,): 1, or pos/R in a circular test."""
    if not radial:
        return np.ones(len(recording))
    circle = axes(recording)[:2]
    radius = np.hypot(*(position(recording, a) for a in circle))
    return position(recording, axis) / np.where(radius > 0, radius, np.nan)
