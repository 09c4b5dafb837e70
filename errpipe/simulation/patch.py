"""Missing effects as equations: a numpy module whose result is added to the simulation's deviations.

Each finding is a sum of profile(position) times driver(state) (`drivers.lowered`), and of ringing or delayed parts
(`drivers.simulated`). It is converted to statements, one operation each, printed as Python here and as C in
`patch_fmu`.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive, runs_on
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, position_name
from errpipe.drivers.simulated import DelayDifference, Ringing, between

CURVE_ERROR = 1e-4  # of a profile's largest value: error bound of linear interpolation between its points
MAX_POINTS = 65536  # of a profile: 2048 waves of 32 points


@dataclass(frozen=True)
class Piece:
    """One finding on one response, in the response's unit. ranges: column -> range in which it acts (else 0)."""

    name: str
    component: str
    unit: str
    summary: str
    pairs: tuple[Lowered | Ringing | DelayDifference, ...]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Statement:
    """One operation: indices of its operands, and its constants."""

    op: str
    of: tuple[int, ...] = ()
    constants: tuple[tuple[str, object], ...] = ()

    def __getitem__(self, name: str) -> object:
        return dict(self.constants)[name]


class Program:
    """Pieces converted to statements; equal operations are computed once. results: piece -> its statement."""

    def __init__(self, pieces: tuple[Piece, ...], recording: Recording):
        self.recording, self.pieces = recording, pieces
        self.statements: list[Statement] = []
        self._numbers: dict[Statement, int] = {}
        self.results = [self._piece(p) for p in pieces]

    def inputs(self) -> tuple[str, ...]:
        """Input columns, in order of first use."""
        return tuple(str(s["name"]) for s in self.statements if s.op == "input")

    def below(self, number: int) -> list[int]:
        """Indices of all statements that a statement needs, including itself, in order."""
        needed = {number}
        for n in range(number, -1, -1):
            if n in needed:
                needed.update(self.statements[n].of)
        return sorted(needed)

    def add(self, op: str, of: tuple[int, ...] = (), **constants: object) -> int:
        """Index of a statement, new or existing."""
        statement = Statement(op, of, tuple(constants.items()))
        if statement not in self._numbers:
            self._numbers[statement] = len(self.statements)
            self.statements.append(statement)
        return self._numbers[statement]

    def _piece(self, piece: Piece) -> int:
        parts = [self._pair(p) if isinstance(p, Lowered) else self._simulated(p) for p in piece.pairs]
        total = parts[0] if len(parts) == 1 else self._sum(tuple(parts), (1.0,) * len(parts))
        for name, (low, high) in piece.ranges.items():
            inside = self.add("within", (self.add("input", name=name),), low=low, high=high)
            total = self.add("product", (total, inside))
        return total

    def _sum(self, of: tuple[int, ...], weights: tuple[float, ...]) -> int:
        return self.add("affine", of, offset=0.0, weights=weights)

    def _simulated(self, op: Ringing | DelayDifference) -> int:
        if isinstance(op, Ringing):
            read = self.add("input", name=op.name)
            rings = self.add("ringing", (read,), frequency=op.frequency, damping=op.damping, pause=op.pause)
            return self._sum((rings,), (op.gain,))
        name, factor = op.column(self.recording)
        read = self.add("input", name=name)
        return self._sum((self.add("late", (read,), delay=op.delay), read), (op.gain * factor, -op.gain * factor))

    def _pair(self, pair: Lowered) -> int:
        driver = self.number_of(pair.driver)
        if pair.axis is None or pair.profile is None:
            factor = 1.0 if pair.profile is None else float(np.asarray(pair.profile(np.zeros(1)))[0])
            return self._sum((driver,), (factor,))
        place = self.add("input", name=position_name(self.recording, pair.axis))
        profile = self._profile(pair.profile, position(self.recording, pair.axis), place, pair.period)
        return profile if pair.driver == d.ONE else self.add("product", (profile, driver))

    def _profile(
        self, shape: Callable[[np.ndarray], np.ndarray], x: np.ndarray, place: int, period: float | None
    ) -> int:
        low, high = (0.0, period) if period else (float(np.nanmin(x)), float(np.nanmax(x)))
        at = np.linspace(low, high if high > low else low + 1.0, 257)
        values = np.asarray(shape(at), dtype=float)
        line = np.polyfit(at - at[0], values, 1)
        if np.abs(np.polyval(line, at - at[0]) - values).max() <= 1e-9 * max(np.abs(values).max(), 1e-300):
            slope, start = float(line[0]), float(line[1] - line[0] * at[0])
            return self.add("affine", (place,), offset=start, weights=(slope,))
        count = 256
        while count < MAX_POINTS and _midpoint_error(shape, at[0], at[-1], count) > CURVE_ERROR * np.abs(values).max():
            count *= 2
        grid = np.linspace(at[0], at[-1], count + 1)
        table = tuple(np.asarray(shape(grid), dtype=float).tolist())
        start, step = float(at[0]), float((at[-1] - at[0]) / count)
        return self.add("lookup", (place,), start=start, step=step, values=table, period=float(period or 0.0))

    def number_of(self, driver: d.Driver) -> int:
        """Index of the statement that computes a driver."""
        match driver:
            case d.Input():
                return self.add("input", name=driver.name)
            case d.Direction():
                return self._side(driver)
            case d.Approach():
                place = self.add("input", name=position_name(self.recording, driver.axis))
                return self.add("approach", (place, self._side(driver)), length=driver.length)
        children = getattr(driver, "of", ())
        of = tuple(self.number_of(c) for c in (children if isinstance(children, tuple) else (children,)))
        own = {n: getattr(driver, n) for n in type(driver).model_fields if n not in ("op", "of")}
        match driver:
            case d.Lag():
                straight = runs_on(driver.of, self.recording)
                return self.add(
                    "lag", of, up=own["tau_up"], down=own["tau_down"], start=own["start"], straight=straight
                )
            case d.Lookup():
                return self.add("lookup", of, **own, period=0.0)
        return self.add(driver.op, of, **own)

    def _side(self, driver: d.Direction | d.Approach) -> int:
        for role in ("direction", "velocity"):
            name = self.recording.name(role, axis=driver.axis)
            if name is not None:
                read = self.add("input", name=name)
                return read if role == "direction" else self.add("side", (read,), start=driver.start)
        place = self.add("input", name=position_name(self.recording, driver.axis))
        return self.add("direction", (place,), threshold=driver.threshold, start=driver.start)


def value(piece: Piece, recording: Recording) -> np.ndarray:
    """A piece on every row of a recording, shape (rows,)."""
    total = np.zeros(len(recording))
    for pair in piece.pairs:
        if not isinstance(pair, Lowered):
            total += pair.value(recording)
            continue
        at = np.zeros(len(recording)) if pair.axis is None else position(recording, pair.axis)
        total += (1.0 if pair.profile is None else pair.profile(at)) * drive(pair.driver, recording)
    for name, (low, high) in piece.ranges.items():
        values = recording.array(name)
        total = total * ((values >= low) & (values <= high))
    return total


def _midpoint_error(shape: Callable[[np.ndarray], np.ndarray], low: float, high: float, count: int) -> float:
    """Largest error of linear interpolation midway between points."""
    grid = np.linspace(low, high, count + 1)
    values = np.asarray(shape(grid), dtype=float)
    middle = np.asarray(shape(0.5 * (grid[1:] + grid[:-1])), dtype=float)
    return float(np.abs(middle - 0.5 * (values[1:] + values[:-1])).max())


# ---------------------------------------------------------------- Python

HELPERS = {
    "lag": '''
def lag(session, t, u, up, down, from_input, straight):
    """First-order lag; the input held from the row before, or running straight from it to this row."""
    y, state = np.empty(len(u)), 0.0
    for k in range(len(u)):
        if k == 0 or session[k] != session[k - 1]:
            state = u[k] if from_input else 0.0
        elif t[k] > t[k - 1]:
            dt, before = t[k] - t[k - 1], u[k - 1]
            tau = up if (0.5 * (u[k] + before) if straight else before) >= state else down
            behind = (u[k] - before) / dt * tau if straight else 0.0
            end = u[k] if straight else before
            state = end - behind + (state - before + behind) * np.exp(-dt / tau)
        y[k] = state
    return y
''',
    "first": '''
def first(session, u):
    """The value at the start of each session."""
    starts = np.r_[True, session[1:] != session[:-1]]
    return u[np.maximum.accumulate(np.where(starts, np.arange(len(u)), 0))]
''',
    "switch": '''
def switch(session, u, on, off):
    """1 once u >= on, 0 once u <= off, else the value before."""
    y, state = np.empty(len(u)), 0.0
    for k in range(len(u)):
        if k == 0 or session[k] != session[k - 1]:
            state = 0.0
        state = 1.0 if u[k] >= on else 0.0 if u[k] <= off else state
        y[k] = state
    return y
''',
    "direction": '''
def direction(session, x, threshold, start):
    """Side last moved from, +1 or -1: turns after a travel of `threshold` against it."""
    y, state, extreme = np.empty(len(x)), float(start), x[0]
    for k in range(len(x)):
        if k == 0 or session[k] != session[k - 1]:
            state, extreme = float(start), x[k]
        if state * (x[k] - extreme) >= 0:
            extreme = x[k]
        elif abs(x[k] - extreme) > threshold:
            state, extreme = -state, x[k]
        y[k] = state
    return y
''',
    "side": '''
def side(session, v, start):
    """Sign of the velocity; at standstill the one before."""
    y, state = np.empty(len(v)), float(start)
    for k in range(len(v)):
        if k == 0 or session[k] != session[k - 1]:
            state = float(start)
        state = np.sign(v[k]) if v[k] != 0 else state
        y[k] = state
    return y
''',
    "approach": '''
def approach(session, x, side, length):
    """What builds up over the travel after a reversal."""
    y, state = np.empty(len(x)), 0.0
    for k in range(len(x)):
        if k == 0 or session[k] != session[k - 1]:
            state = side[k]
        else:
            state = side[k] - (side[k] - state) * np.exp(-abs(x[k] - x[k - 1]) / length)
        y[k] = state
    return y
''',
    "ringing": '''
def ringing(session, t, u, frequency, damping, pause):
    """q'' + 2 damping w q' + w^2 q = w^2 u, exact for u straight between rows; at rest first and after a pause."""
    w = 2 * np.pi * frequency
    decay, turn = damping * w, w * np.sqrt(1 - damping**2)
    y, q, rate = np.empty(len(u)), 0.0, 0.0
    for k in range(len(u)):
        dt = t[k] - t[k - 1] if k else 0.0
        if k == 0 or session[k] != session[k - 1] or dt > pause:
            q, rate = u[k], 0.0
        elif dt > 0:
            slope = (u[k] - u[k - 1]) / dt
            behind = 2 * damping / w * slope
            z, v = q - u[k - 1] + behind, rate - slope
            fade, c, s = np.exp(-decay * dt), np.cos(turn * dt), np.sin(turn * dt) / turn
            q = fade * (z * c + (v + decay * z) * s) + u[k] - behind
            rate = fade * (v * c - (decay * v + w * w * z) * s) + slope
        y[k] = q
    return y
''',
    "late": f"\n{inspect.getsource(between)}"
    + '''

def late(session, t, u, delay):
    """u a time `delay` ago; before a session begins its first value."""
    y = np.full(len(u), np.nan)
    for s in np.unique(session):
        known = (session == s) & np.isfinite(u)
        if known.any():
            at, first = np.unique(t[known], return_index=True)
            y[known] = between(at, u[known][first], t[known] - delay) if at.size > 1 else u[known]
    return y
''',
}

HEAD = '''"""What the simulation lacks: {title}

corrected(simulated, columns, t) gives the simulated deviations (actual minus commanded) with what was missing;
deviation(columns, t) what is to be ADDED to them, where neither gain nor offset was off:

    columns   name -> values, shape (rows,): {inputs}
    t         time of each row, s; session: number of each row's session, where states start anew (default: one)

Needs numpy only.
"""

import numpy as np
'''

TAIL = '''

def deviation(columns, t, session=None):
    """Component -> deviation to add, shape (rows,); units: {units}."""
    session = np.zeros(len(t), dtype=int) if session is None else np.asarray(session)
    t = np.asarray(t, dtype=float)
    return {{
{sums}
    }}


GAIN_OFFSET = {gains}  # component -> what its simulated deviation is multiplied by, and what is added


def corrected(simulated, columns, t, session=None):
    """Component -> simulated deviation with what was missing, from component -> simulated deviation."""
    missing = deviation(columns, t, session)
    scaled = {{c: GAIN_OFFSET.get(c, (1.0, 0.0)) for c in simulated}}
    return {{c: scaled[c][0] * np.asarray(v) + scaled[c][1] + missing.get(c, 0.0) for c, v in simulated.items()}}
'''


def python_module(
    pieces: tuple[Piece, ...], recording: Recording, title: str, gains: Mapping[str, tuple[float, float]]
) -> str:
    """Source of a module with one function for each finding, and their sum for each response.

    gains: component -> gain and offset that set its simulated deviation right.
    """
    program = Program(pieces, recording)
    kinds = recording.manifest.columns
    inputs = ", ".join(f"{n} ({kinds[n].unit or kinds[n].role})" for n in program.inputs())
    used = {s.op for s in program.statements}
    text = HEAD.format(title=_plain(title), inputs=_plain(inputs) or "none")
    text += "".join(f"\n{code.rstrip()}\n" for op, code in HELPERS.items() if op in used)
    for piece, result in zip(pieces, program.results, strict=True):
        lines = [f"    n{n} = {_python(program.statements[n])}" for n in program.below(result)]
        text += f'\n\ndef {piece.name}(columns, t, session):\n    """{_plain(piece.summary)}"""\n' + "\n".join(lines)
        text += f"\n    return n{result}\n"
    components = dict.fromkeys(p.component for p in pieces)
    sums = [
        f'        "{c}": ' + " + ".join(f"{p.name}(columns, t, session)" for p in pieces if p.component == c) + ","
        for c in components
    ]
    units = ", ".join(f"{c} {next(p.unit for p in pieces if p.component == c)}" for c in components)
    return text.replace("\n\n\n\ndef", "\n\n\ndef") + TAIL.format(
        units=units or "none", sums="\n".join(sums), gains=repr(dict(gains))
    )


def _plain(text: str) -> str:
    return text.replace("\\", "/").replace('"""', "'''").replace("\n", " ")


def _python(s: Statement) -> str:
    """A statement as a numpy expression."""
    of = [f"n{k}" for k in s.of]
    match s.op:
        case "input":
            return f"np.asarray(columns[{s['name']!r}], dtype=float)"
        case "constant":
            return f"np.full(len(t), {s['value']!r})"
        case "affine":
            parts = [f"{w!r} * {n}" if w != 1.0 else n for w, n in zip(s["weights"], of, strict=True)]  # type: ignore[call-overload]
            return " + ".join(([repr(s["offset"])] if s["offset"] else []) + parts)
        case "product":
            return " * ".join(of)
        case "power":
            return f"np.sign({of[0]}) * np.abs({of[0]}) ** {s['exponent']!r}"
        case "clip":
            return f"np.clip({of[0]}, {s['low']!r}, {s['high']!r})"
        case "within":
            return f"(({of[0]} >= {s['low']!r}) & ({of[0]} <= {s['high']!r})).astype(float)"
        case "lookup":
            values, start, step = s["values"], s["start"], s["step"]
            place = f"np.mod({of[0]}, {s['period']!r})" if s["period"] else of[0]
            grid = f"{start!r} + {step!r} * np.arange({len(values)})"  # type: ignore[arg-type]
            numbers = ", ".join(f"{v:.9g}" for v in values)  # type: ignore[attr-defined]
            table = textwrap.fill(numbers, 112, initial_indent=" " * 8, subsequent_indent=" " * 8)
            return f"np.interp({place}, {grid}, [\n{table}\n    ])"
        case "lag":
            rest = f"{s['up']!r}, {s['down']!r}, {s['start'] == 'input'}, {s['straight']}"
            return f"lag(session, t, {of[0]}, {rest})"
    rest = "".join(f", {value!r}" for _, value in s.constants)
    if s.op in ("ringing", "late"):
        return f"{s.op}(session, t, {of[0]}{rest})"
    return f"{s.op}(session, {', '.join(of)}{rest})"
