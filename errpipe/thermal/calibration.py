"""The interval of a mixture of families: its factor and half width, from leave-one-group-out residuals.

The variance of a prediction is that of the noise; the rest of the leave-one-run-out residual is split (`spread`) into
a constant share, one proportional to the spread of fits without a run, and one to the spread of families. A row far
outside in a direction in which these disagree has a wide interval, whatever the scale of the machine.
"""

from __future__ import annotations

import numpy as np

from errpipe.domain import driver as d
from errpipe.thermal import spread
from errpipe.thermal.arithmetic import since_start
from errpipe.thermal.competition import HALF, MIXTURE, RUN, WARMTH, Outcome, groupings
from errpipe.thermal.interval import GROWTH, Intervals, LeftOut, growth_of_one_day, of_next_run
from errpipe.thermal.linear import LinearProblem

# Weight of the logarithm of the half width that covers held-out environments, relative to that of runs. Chosen with
# `spread.FITS`: 0.5 covers 0.90 on average, 0.35 0.89, and 85 to 95 % on 28 and 31 of 36 machines.
SEASONS = 0.35
LEAST = 0.01  # of the residual: a smaller variance between fits or families explains none of it (by judgement)
ROUNDING = 1e-6  # um: a residual below it is rounding, so its variance has no shares (no gauge resolves it)


def interval(
    problem: LinearProblem,
    outcome: Outcome,
    total: d.Driver,
    coverage: float,
    environment: str,
    one_environment: bool,
    noise: float,
) -> tuple[d.Driver, Intervals]:
    """Factor of the interval, and its half widths. total: the mixture; one_environment: all rows share one; noise: um.

    With one environment, or with blocks of too few runs (each lies between fitted ones), no held-out group goes as
    far as a prediction may: the variance is the residual and the spread of fits, increased by `GROWTH`. For
    blocks, the residual of each half of a run, predicted by the other, sets the half width.
    """
    groups, rows = tuple(problem.groups), problem.rows
    way = groupings(problem.recording, problem.group, groups, environment)[0]
    fits = spread.between_fits(outcome, groups, way.folds, problem.recording, rows)
    left = outcome.left.get(way.name, {}).get(MIXTURE, 0.0)
    left = left**2 if left > ROUNDING else 0.0
    near = HALF in outcome.predictions or one_environment
    if near:
        offset, shares = 1.0, [(1.0 / left, fits, spread.squared(fits, problem.recording))] if left > 0.0 else []
    else:
        offset, shares = _shares(problem, outcome, total, fits, left, noise)
    factor = np.sqrt(offset + sum((weight * variance for weight, _, variance in shares), np.zeros(rows.size)))
    driver = spread.root(offset, [(weight, directions) for weight, directions, _ in shares])
    if HALF in outcome.predictions:
        p = outcome.predictions[HALF]
        halves = LeftOut((problem.response - p)[rows], p[rows])
        half = of_next_run(halves, problem.group[rows], coverage, factor[rows], problem.within_one_day)
        growth = growth_of_one_day(half, coverage) if problem.run_count == 1 else GROWTH
        return driver, Intervals(half, half, 0.0, growth)
    growth = GROWTH if near else 0.0
    half = _half_width(problem, outcome, coverage, environment, one_environment, factor, growth)
    return driver, Intervals(half, half, 0.0, growth)


def _shares(
    problem: LinearProblem, outcome: Outcome, total: d.Driver, fits: spread.Directions, left: float, noise: float
) -> tuple[float, list[tuple[float, spread.Directions, np.ndarray]]]:
    """Constant share of the variance, and for each spread its weight (1/um2), directions and values, um2, (rows,).

    Together they have a mean of at least one on the fitted rows: no spread counts less than its value, however small
    the residual beyond the noise. left: leave-one-run-out, um2; noise: um. A family with inputs that the mixture lacks
    excluded: the interval must not need further columns.
    """
    if left <= 0.0:
        return 1.0, []
    beyond = 1.0 - min(noise**2 / left, 1.0)
    groups, recording, rows = tuple(problem.groups), problem.recording, problem.rows
    known = {*recording.names("temperature"), *d.inputs(total)}
    rivals = [e for e in outcome.rivals if all(known.issuperset(d.inputs(n)) for _, _, n in e.parts(groups))]
    families = spread.between_families(rivals, groups, recording, rows)
    offset, shares = 1.0, []
    for share, directions, variance in (
        (spread.FITS, fits, spread.squared(fits, recording)),
        (spread.FAMILIES, families, outcome.apart),
    ):
        if directions:
            mean = max(float(np.nanmean(variance[rows])), LEAST * left)
            offset -= beyond * share
            shares.append((max(beyond * share / mean, 1.0 / left), directions, variance))
    return offset, shares


def _half_width(
    problem: LinearProblem,
    outcome: Outcome,
    coverage: float,
    environment: str,
    one_environment: bool,
    factor: np.ndarray,
    growth: float,
) -> float:
    """Half width of the interval at a factor of one, um, from held-out groups; factor: of each row, (rows,).

    A held-out run is predicted by a fit with its environment, a held-out environment by a fit on the others alone.
    The next environment is predicted by a fit on all of them, between the two (`SEASONS`), and so is a run if there are
    few: neither is raised. If all rows share one environment, nothing is known of the next one: the widest of all
    groupings is used, with the level raised as for few groups. Errors count from a run's first reading, as a table's.
    """
    rows, run = problem.rows, problem.recording.run_codes()
    environment = environment if environment in outcome.predictions else WARMTH
    half = {
        name: LeftOut(since_start(problem.response - p, run, 1)[0][rows], p[rows]).half_width(
            problem.group[rows], coverage, problem.run_count, one_environment, factor[rows], growth
        )
        for name, p in outcome.predictions.items()
        if one_environment or name in (RUN, environment)
    }
    if one_environment:
        return max(half.values())
    return half[RUN] ** (1.0 - SEASONS) * (half.get(environment) or half[RUN]) ** SEASONS
