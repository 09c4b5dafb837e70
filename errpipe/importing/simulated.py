"""Simulated columns: positions become deviations, and a force with its simulation becomes the response."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from errpipe.domain import components, units
from errpipe.domain.recording import ROLE_UNITS
from errpipe.errors import DataError
from errpipe.importing.proposed import Proposal
from errpipe.importing.words import FORCES, SIMULATED, difference, plain

AGAINST = -0.5  # correlation below which a simulation has the opposite sign to its recording
ALONG = 0.1  # of the command: a simulated value with a slope of 1 within this tolerance is a position, not a deviation


def component_of_force(header: str, unit: str | None, axis: str) -> str | None:
    """F_X for a simulated force or torque, None if a header and its unit name none."""
    force = unit in (*ROLE_UNITS["force"], *ROLE_UNITS["torque"]) or (unit is None and re.search(FORCES, plain(header)))
    return f"F_{axis}" if force and re.search(SIMULATED, plain(header)) else None


def as_a_load(p: Proposal, axis: str) -> str:
    """Hint how to diagnose a recorded force, torque or current; empty if there is none."""
    found = p.first("torque") or p.first("force") or p.first("current")
    hint = f"; the load of a drive is one with --set {found}.role=error --set {found}.component=F_{axis}"
    return hint if found else ""


def forces_as_responses(p: Proposal) -> None:
    """A force with a simulation is the response, unless a deviation has its own simulation.

    Raises DataError if there are several forces, or if the unit belongs to another quantity.
    """
    for name in [n for n, e in p.entries.items() if e["role"] == "simulated" and e["component"].startswith("F_")]:
        component = p.entries[name]["component"]
        measured = [n for n, e in p.entries.items() if e["role"] in ("force", "torque")]
        twins = {e["component"] for e in p.entries.values() if e["role"] == "simulated"}
        if any(e["role"] == "error" and e["component"] in twins for e in p.entries.values()) or not measured:
            continue
        if len(measured) > 1:
            raise DataError(
                f"there are several forces ({', '.join(measured)}) for the simulated {name!r}: select its force "
                f"with --set {measured[0]}.role=error"
            )
        (force,) = measured
        unit = p.entries[force]["unit"]
        if ("N" if unit in ROLE_UNITS["force"] else "N m") not in components.allowed_units(component):
            raise DataError(
                f"{force!r} is in {unit}, and {component} is the drive force of a linear axis in N: divide by the "
                "lever (screw lead / 2 pi), or name a rotary axis with --axis"
            )
        p.entries[force] = {"role": "error", "component": component, "unit": unit}
        p.guesses[force] = f"{p.guesses.get(force, '')}; {component}, because its simulation is recorded".strip("; ")


def of_the_only_response(p: Proposal) -> None:
    """A simulation that names no component belongs to the only response: a diameter with `simulated`."""
    errors = [e for e in p.entries.values() if e["role"] == "error"]
    simulations = [n for n, e in p.entries.items() if e["role"] == "simulated"]
    if len(errors) != 1 or len(simulations) != 1:
        return
    (name,), component = simulations, errors[0]["component"]
    entry, why = p.entries[name], p.guesses.get(name, "")
    from_axis = f"component {entry['component']} from the axis"
    if entry["component"] != component and from_axis in why and entry["unit"] in components.allowed_units(component):
        entry["component"] = component
        p.guesses[name] = why.replace(from_axis, f"component {component}, the only response")


def positions_as_deviations(p: Proposal) -> list[str]:
    """Convert simulated positions, which rise with the command one for one, to simulated deviations; returns which."""
    turned = []
    for name in [n for n, e in p.entries.items() if e["role"] == "simulated" and n in p.data]:
        entry = p.entries[name]
        axis = next((e["axis"] for e in p.entries.values() if e.get("axis")), None)
        command = (p.first("command", axis) or p.first("position", axis)) if axis else None
        if command not in p.data or entry["component"] != components.positioning(str(axis)):
            continue
        x, y = p.data[command], p.data[name]
        good = np.isfinite(x) & np.isfinite(y)
        if good.sum() < 4 or not np.ptp(x[good]):
            continue
        unit = p.entries[command].get("unit", "mm")
        same = entry.get("unit") == unit or "no unit is stated" in p.guesses.get(name, "")
        if not same or abs(np.polyfit(x[good], y[good], 1)[0] - 1.0) > ALONG:
            continue
        own = components.unit(entry["component"])
        convert = units.conversion("position", unit)
        less = convert(y) - convert(x) if convert is not None else y - x
        p.data[name], p.entries[name] = less * (1e3 if own == "um" else np.pi / 180 * 1e6), {**entry, "unit": own}
        p.guesses[name] = f"it rises with {command} one for one: simulated positions minus {command}, in {own}"
        turned.append(name)
    return turned


def change_signs(p: Proposal, known: Sequence[str]) -> None:
    """Simulated deviations as actual minus commanded: by their own header, else as the recorded ones.

    known: columns whose sign is already known. A simulation with negative correlation to the recording as written keeps
    its sign: then only the recording has the opposite sign.
    """
    for name in [n for n, e in p.entries.items() if e["role"] == "simulated" and n in p.data and n not in known]:
        component = p.entries[name]["component"]
        says = plain(" ".join(p.entries[name].get("_headers", (name,))))
        difference_stated = difference(says)
        reason = f"its header states {says!r}" if difference_stated is not None and difference_stated[0] < 0 else ""
        if difference_stated is None:
            reason = _sign_of_recorded(p, name, component)
        if reason:
            entry = p.entries[name]
            raw = p.put(f"{name}_as_written", p.data.pop(name), role="ignore")
            p.entries[name] = {**entry, "derived": {"of": raw, "factor": -1.0}}
            p.guesses[name] = f"{p.guesses.get(name, '')}; {reason}: the sign is changed".strip("; ")


def _sign_of_recorded(p: Proposal, name: str, component: str) -> str:
    """Why a simulated column changes its sign with the recorded one; '' if it does not."""
    for error, entry in p.entries.items():
        raw = entry.get("derived", {}).get("of")
        if entry["role"] != "error" or entry["component"] != component or raw not in p.data:
            continue
        x, y = p.data[raw], p.data[name]
        good = np.isfinite(x) & np.isfinite(y)
        varies = good.sum() > 3 and np.ptp(x[good]) > 0 and np.ptp(y[good]) > 0
        if not varies or np.corrcoef(x[good], y[good])[0, 1] > AGAINST:
            return f"as for {error}"
        p.guesses[name] = f"{p.guesses.get(name, '')}; negative correlation with {raw}: its sign is kept".strip("; ")
    return ""
