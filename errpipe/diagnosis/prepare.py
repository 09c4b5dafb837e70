"""Selection of usable rows, and conditioned columns: filled, smoothed, motion derived from positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError
from errpipe.fitting.noise_floor import smooth

LEAST_ROWS = 30  # fewer rows cannot support a finding and a hold-out
MOST_SLOW, MOST_FAST, STRETCHES = 4000, 20000, 40  # rows selected; more cost time and hardly change the result
MOST_MISSING = 0.75  # share of gaps above which a sensor is ignored; a sensor that failed half of the time is a finding
AT_ONCE = 100_000  # rows whose neighbours are in memory at once
BETWEEN = ("position", "command", "cut_length", "velocity", "acceleration")  # roles whose gaps are interpolated,
SLOW_ROLES = ("temperature", "pressure", "humidity")
STEPWISE = ("direction", "spindle_speed", "feed", "coolant", "load", "overhang", "depth_of_cut")  # or held
SAME = 1e-9  # share of the recorded rms below which a difference is rounding in a file
REVERSED = 0.25  # threshold: residual variance with the simulated sign reversed, over the recorded variance
FOLLOWED = 6.0  # standard errors: threshold for the noise of a reading in the mismatch


@dataclass(frozen=True)
class Pair:
    """A response with its simulated value, and the rows on which both can be compared.

    rows: indices into the recording, in its order; mismatch = error - simulated there, in `unit`.
    reversed: one of the two columns has the opposite sign: mismatch = error + simulated.
    outliers: removed rows (indices into the recording).
    """

    component: str
    unit: str
    error: str
    simulated: str
    rows: np.ndarray
    mismatch: np.ndarray
    outliers: np.ndarray
    reversed: bool = False  # is the simulated value used with the opposite sign?

    def twin(self, recording: Recording) -> np.ndarray:
        """The simulated value on the rows, with the sign used for the comparison."""
        values = recording.array(self.simulated)[self.rows]
        return -values if self.reversed else values


def pairs(recording: Recording) -> tuple[list[Pair], list[str]]:
    """Every response with a simulated value, and reasons why others cannot be used. Raises DataError if none can."""
    accepted: list[Pair] = []
    refused = [] if recording.names("error") else ["no column of role error, or of a force that names its component"]
    for error in recording.names("error"):
        component = recording.manifest.columns[error].component
        twin = recording.name("simulated", component=component)
        if twin is None:
            refused.append(f"{component}: no column of role simulated for it")
            continue
        units = [recording.manifest.columns[n].unit for n in (error, twin)]
        if units[0] != units[1]:
            refused.append(f"{component}: recorded in {units[0]}, simulated in {units[1]}; they must be the same")
            continue
        try:
            accepted.append(_pair(recording, str(component), error, twin, units[0] or "um"))
        except DataError as err:
            refused.append(str(err))
    if not accepted:
        head = "diagnose: no pair of responses (a simulation in a file of its own: --simulation FILE)"
        raise DataError("\n  ".join([head, *refused]))
    return accepted, refused


def _pair(recording: Recording, component: str, error: str, twin: str, unit: str) -> Pair:
    mismatch = recording.array(error) - recording.array(twin)
    rows = np.flatnonzero(np.isfinite(mismatch))
    if rows.size < LEAST_ROWS:
        raise DataError(
            f"{component}: only {rows.size} rows hold both a recorded and a simulated value (at least {LEAST_ROWS})"
        )
    rows = rows[~_repeated(recording, rows)]
    if rows.size < LEAST_ROWS:
        raise DataError(f"{component}: only {rows.size} different rows (at least {LEAST_ROWS})")
    if np.nanstd(recording.array(error)[rows]) == 0:
        raise DataError(f"{component}: the recorded value never changes")
    mismatch[np.abs(mismatch) < SAME * np.nanstd(recording.array(error)[rows])] = 0.0
    recorded, simulated = recording.array(error)[rows], recording.array(twin)[rows]
    alike = min(float(np.var(recorded)), float(np.var(recorded - simulated)))
    turned = float(np.var(recorded + simulated)) < REVERSED * alike
    if turned:
        mismatch = recording.array(error) + recording.array(twin)
    outlying = spikes(mismatch[rows])
    keep = _judged_rows(recording, rows)
    rows, outlying = rows[keep], outlying[keep]
    return Pair(component, unit, error, twin, rows[~outlying], mismatch[rows[~outlying]], rows[outlying], turned)


def _judged_rows(recording: Recording, rows: np.ndarray) -> np.ndarray:
    """Selected rows of a long recording: a random sample, or whole stretches of a fast trace."""
    step = np.diff(recording.time()[rows])
    fast = recording.name("time") is not None and np.median(step) < 0.1
    most = MOST_FAST if fast else MOST_SLOW
    if rows.size <= most:
        return np.arange(rows.size)
    if fast:
        first = np.searchsorted(np.arange(rows.size) * STRETCHES // rows.size, np.arange(STRETCHES))
        return np.concatenate([np.arange(a, a + most // STRETCHES) for a in first])
    return np.sort(np.random.default_rng(0).choice(rows.size, most, replace=False))


def _repeated(recording: Recording, rows: np.ndarray) -> np.ndarray:
    """Rows equal to the previous row in every cell."""
    frame = recording.frame.iloc[rows]
    cells, gaps = frame.to_numpy(), frame.isna().to_numpy()
    return np.r_[False, ((cells[1:] == cells[:-1]) | (gaps[1:] & gaps[:-1])).all(axis=1)]


def spikes(values: np.ndarray, times: float = 6.0) -> np.ndarray:
    """Isolated outliers: far from the median of their six neighbours, which agree with each other."""
    if values.size < 15:
        return np.zeros(values.size, dtype=bool)
    gap, spread = distance_from_neighbours(values)
    scale = 1.4826 * np.median(np.abs(gap)) + 1e-12
    return np.abs(gap) > times * np.maximum(scale, 1.5 * 1.4826 * spread)


def distance_from_neighbours(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the median of the six neighbours, (n,), and these neighbours' median absolute deviations."""
    padded = np.pad(values, 3, mode="reflect")
    gap, spread = np.empty_like(values), np.empty_like(values)
    for a in range(0, values.size, AT_ONCE):
        b = min(a + AT_ONCE, values.size)
        around = np.stack([padded[a + k : b + k] for k in (0, 1, 2, 4, 5, 6)])
        middle = np.median(around, axis=0)
        gap[a:b], spread[a:b] = values[a:b] - middle, np.median(np.abs(around - middle), axis=0)
    return gap, spread


def condition(recording: Recording) -> Recording:
    """The recording with its driving columns conditioned: gaps filled, sensors smoothed, motion from positions.

    Sensors that miss more than MOST_MISSING of their rows, or never change, are dropped. The error and
    simulated columns are not changed.
    """
    run = recording.run_codes()
    session = sessions(recording)
    t = recording.time()
    columns: dict[str, np.ndarray] = {}
    dropped = []
    for role in (*SLOW_ROLES, "force"):
        for name in recording.names(role):
            values = recording.array(name)
            if not usable(values):
                dropped.append(name)
                continue
            columns[name] = filled = fill(t, values, session)
            if role != "force":
                columns[name] = smooth(filled, segments(filled, run, _long(~np.isfinite(values))))
    for role in (*BETWEEN, *STEPWISE):
        for name in recording.names(role):
            values = recording.array(name)
            if not np.isfinite(values).any():
                dropped.append(name)
                continue
            columns[name] = hold(values, session) if role in STEPWISE else fill(t, values, session)
    columns |= motion(recording, columns)
    return Recording(recording.manifest, recording.frame.assign(**columns).drop(columns=dropped), between="inferred")


def followed(recording: Recording, conditioned: Recording, pair: Pair) -> Recording:
    """The conditioned recording; a sensor whose noise correlates with the mismatch is not smoothed.

    A controller that compensates by a sensor transfers the sensor's noise to the axis.
    """
    run, rows = recording.run_codes()[pair.rows], pair.rows
    same = (run[2:] == run[1:-1]) & (run[1:-1] == run[:-2])
    if same.sum() < LEAST_ROWS:
        return conditioned
    y, kept = np.diff(pair.mismatch, 2)[same], {}
    y -= y.mean()
    for name in (n for role in SLOW_ROLES for n in conditioned.names(role)):
        if name not in conditioned.frame.columns:
            continue
        read = fill(recording.time(), recording.array(name), sessions(recording))
        noise = np.diff((read - conditioned.array(name))[rows], 2)[same]
        size = float(np.sqrt(np.var(noise) * noise.size * (y @ y)))
        if size > 0 and abs(noise @ y) / size > FOLLOWED / np.sqrt(same.sum() / 3.0):  # second differences overlap
            kept[name] = read
    return Recording(recording.manifest, conditioned.frame.assign(**kept), between="inferred") if kept else conditioned


def segments(values: np.ndarray, run: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Run codes, split where a reading jumps or starts or ends being held: no smoothing across these."""
    step = np.abs(np.diff(values))
    jump = step > np.maximum(12 * np.median(step) + 1e-9, 0.35)
    usual_step = np.convolve(step, np.ones(9) / 9, mode="same") - step / 9 if step.size >= 9 else step
    return run * 1000 + np.r_[0, np.cumsum((jump & (step > 8 * usual_step)) | (held[1:] != held[:-1]))]


def usable(values: np.ndarray) -> bool:
    """Does a sensor have enough different finite values?"""
    return np.isfinite(values).mean() >= 1 - MOST_MISSING and np.nanmax(values) > np.nanmin(values)


def fill(t: np.ndarray, values: np.ndarray, session: np.ndarray) -> np.ndarray:
    """Missing values interpolated in time within a session, held constant at its ends."""
    out = values.copy()
    bad = ~np.isfinite(values)
    if not bad.any():
        return out
    for s in np.unique(session[bad]):
        rows = np.flatnonzero(session == s)
        good = rows[~bad[rows]]
        if good.size:
            between = np.interp(t[rows], t[good], values[good])
            last = values[good][np.maximum(np.searchsorted(good, rows, side="right") - 1, 0)]
            out[rows] = np.where(bad[rows], np.where(_long(bad)[rows], last, between), values[rows])
    missing = ~np.isfinite(out)
    out[missing] = np.nanmedian(values)
    return out


def _long(bad: np.ndarray, least: int = 12) -> np.ndarray:
    """Rows in gaps so long that a controller would have held the sensor's last value."""
    edges = np.flatnonzero(np.diff(np.r_[0, bad.astype(int), 0]))
    out = np.zeros(bad.size, dtype=bool)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        out[a:b] = b - a >= least
    return out


def hold(values: np.ndarray, session: np.ndarray) -> np.ndarray:
    """Missing values held from the previous row, at the start of a session from the next one."""
    import pandas as pd

    held = pd.Series(values).groupby(session).transform(lambda s: s.ffill().bfill())
    return held.fillna(np.nanmedian(values)).to_numpy(dtype=float)


def motion(recording: Recording, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Velocities and accelerations from positions if rows are dense: less noisy than a recorded speed."""
    out: dict[str, np.ndarray] = {}
    t, run = recording.time(), recording.run_codes()
    step = np.diff(t)
    if recording.name("time") is None or len(t) < 50 or np.median(step[step > 0]) > 0.1:
        return out
    for name in recording.names("velocity"):
        axis = recording.manifest.columns[name].axis
        source = recording.name("command", axis=axis) or recording.name("position", axis=axis)
        if source is None:
            continue
        for reading, order in ((name, 1), *((a, 2) for a in recording.names("acceleration", axis=axis))):
            out[reading] = _less_noisy(derivative(t, columns[source], run, order), columns[reading])
    return out


def _less_noisy(derived: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """The derivative; at edges of a short push, beyond the noise, the reading; all of it if it has another meaning."""
    if min(np.ptp(derived), np.ptp(recorded)) <= 0 or np.corrcoef(derived, recorded)[0, 1] <= 0.98:
        return recorded
    difference = np.abs(derived - recorded)
    return np.where(difference > 4.0 * 1.4826 * np.median(difference), recorded, derived)


def derivative(t: np.ndarray, x: np.ndarray, run: np.ndarray, order: int = 1) -> np.ndarray:
    """First or second derivative of the parabola through three rows, within runs, shape of t."""
    out = np.zeros_like(x)
    for r in np.unique(run):
        rows = np.flatnonzero(run == r)
        at, first = np.unique(t[rows], return_index=True)
        if at.size < 3:
            continue
        y = x[rows][first]
        left, right = np.diff(at)[:-1], np.diff(at)[1:]
        slope_left, slope_right = np.diff(y)[:-1] / left, np.diff(y)[1:] / right
        if order == 1:
            inner = (slope_left * right + slope_right * left) / (left + right)
        else:
            inner = 2 * (slope_right - slope_left) / (left + right)
        out[rows] = np.interp(t[rows], at, np.r_[inner[0], inner, inner[-1]])
    return out
