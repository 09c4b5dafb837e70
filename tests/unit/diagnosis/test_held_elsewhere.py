"""What a simulation may hold under another name; what held-out rows bear out beyond the noise of a row."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from errpipe.diagnosis import decompose, holdout, hypotheses, judge, plausible, prepare, unnamed
from errpipe.diagnosis.holdout import HeldOut
from errpipe.diagnosis.prepare import condition
from errpipe.terms import NEVER

from .machines import axis, spindle


def test_an_effect_takes_the_place_of_the_part_that_stands_in_for_it():
    case = condition(spindle())
    rows = np.arange(len(case))
    library = hypotheses.build(case, "E_Z", rows)
    (first, *_), holding = decompose.decompose(3.0 * (case.array("T_bed") - 20.0), library, case, rows, 0.3)
    drift = next(i for i, h in enumerate(library.hypotheses) if h.drivers == ("T_bed",) and not h.nonlinear[0])
    growth = next(i for i, h in enumerate(library.hypotheses) if h.drivers == ("rpm",))
    assert library.hypotheses[drift].effect in [p.hypothesis.effect for p in first.parts]
    again = holding(first, drift)
    assert again[0].leftover < 0.01 and library.hypotheses[drift].effect in [
        p.hypothesis.effect for p in again[0].parts
    ]
    assert holding(first, growth) == []
    assert decompose.decompose(np.zeros(rows.size), library, case, rows, 0.3)[1] is None


def largest_part(case, component: str, signal: np.ndarray) -> tuple[str, list[float]]:
    """Effect of a signal's largest part; rms of its form, of what that owes to its reference, and of its departures."""
    rows = np.arange(len(case))
    library = hypotheses.build(case, component, rows)
    (first, *_), _ = decompose.decompose(signal, library, case, rows, 0.3)
    part = max(first.parts, key=lambda p: float(np.std(p.contribution)))
    return part.hypothesis.effect, [float(np.std(v)) for v in (part.core, part.reference, part.slack)]


def test_the_value_that_a_rise_is_counted_from_is_form_and_the_state_at_the_start_departs():
    """Departures have gains of their own: one gain for both would leave what they took from another effect."""
    case = condition(axis())
    expansion = 11e-3 * case.array("x") * (case.array("T_nut") - 24.0)
    effect, (form, reference, departs) = largest_part(case, "EXX", expansion)
    assert effect == "scale_expansion" and min(form, reference) > 5.0 and departs < 0.1
    case = condition(spindle())
    start = 6.0 * np.exp(-(case.array("t") - case.array("t")[0]) / 3000.0)
    effect, (_, reference, departs) = largest_part(case, "E_Z", 4 * (case.array("T_room") - 20.0 + start))
    assert effect == "ambient_drift" and reference == 0.0 and departs > 1.0


@pytest.mark.parametrize(
    ("after", "noise", "named", "stands"),
    [(1.0, 1.0, 1.0, True), (1.0, 0.2, 1.0, False), (1.3, 1.0, 1.0, False), (1.0, 1.0, 1.09, False)],
)
def test_names_are_judged_by_what_they_leave_beyond_the_noise_of_a_row(after, noise, named, stands):
    """And by what they bring beside a recalibration: 200 rows at 1.1 to 1.0 rms are worth 19, to 1.09 nearly 2."""
    held = HeldOut("40 blocks", 1.23, after, (0.4,), named, named, named, 1.1, named)
    explanation = SimpleNamespace(accepted=[SimpleNamespace(gain=20.0)])
    search = SimpleNamespace(rows=None)
    case = SimpleNamespace(noise_estimate=noise, explanation=explanation, search=search, run=np.zeros(200))
    assert unnamed.confirmed_by_held_out(case, held) is stands


@pytest.mark.parametrize(
    ("gain", "again", "named", "mask", "found"),
    [
        (30.0, 0.2, 1.09, (), False),
        (30.0, 0.6, 1.09, (), True),
        (80.0, 0.2, 1.09, (), True),
        (30.0, 0.2, 1.0, (), True),
        (80.0, 1.0, 1.0, ("runs", ("2",)), False),
        (30.0, 1.0, 1.0, ("runs", ("2",)), True),
    ],
)
def test_a_weak_name_must_be_found_again_without_a_fold(gain, again, named, mask, found):
    """Or another one that brings held-out rows as much: look-alikes take each other's place.

    What acts in part was chosen on all rows: no fold could but find it again, so it must bring them what it promises.
    """
    held = HeldOut("40 blocks", 1.23, named, (again,), named, named, named, 1.1, named, again=not mask)
    accepted = [SimpleNamespace(gain=gain, hypothesis=SimpleNamespace(mask=mask))]
    explanation, search = SimpleNamespace(accepted=accepted), SimpleNamespace(rows=None)
    case = SimpleNamespace(chosen=lambda: [(0, 1.0)], explanation=explanation, held=held, run=np.zeros(200))
    case.search = search
    assert judge._found_again(case) is found


def test_what_acts_in_part_was_chosen_on_all_rows_and_is_unknown_to_a_fold(monkeypatch):
    raw = axis(5, hidden=lambda c: -3.0 * c["dir"])
    (pair,), _ = prepare.pairs(raw)
    case = judge.diagnose(raw, prepare.condition(raw), pair)
    chosen, every = [i for i, _ in case.chosen()], np.arange(len(case.library.hypotheses))
    masked = ~np.isin(every, [k for i in chosen for k in case.library.family(i)])
    for i in np.flatnonzero(masked):  # its key is kept: the library finds it by that
        monkeypatch.setitem(case.library.hypotheses[i].__dict__, "mask", ("runs", ("1",)))
    seen, made = [], holdout._without_fold
    monkeypatch.setattr(holdout, "_without_fold", lambda search, f: seen.append(search.prior) or made(search, f))
    holdout.held_out(case)
    assert all((prior[masked] == NEVER).all() and (prior[~masked] > NEVER).any() for prior in seen)
    assert (case.search.prior[masked] > NEVER).any()


@pytest.mark.parametrize(
    ("slope", "rising", "expansion", "doubtful"),
    [(4.0, 0.0, 20.0, True), (9.0, 0.0, 20.0, False), (9.0, 0.0, 40.0, True), (0.5, 5.0, 20.0, True)],
)
def test_what_looks_like_a_part_of_the_simulation_may_be_its_gain(slope, rising, expansion, doubtful):
    """Counted from another temperature a simulated expansion holds a lead error, which may have a gain of its own."""
    x = np.linspace(-1.0, 1.0, 101)
    rise = np.cos(3 * np.arange(101.0)) * np.sqrt(2.0)
    whole = 2.0 * x + expansion * rise * x
    part = SimpleNamespace(reference=2.0 * x, core=whole, contribution=whole)
    case = SimpleNamespace(decomposition=SimpleNamespace(parts=(part,)))
    found = SimpleNamespace(contribution=slope * x + rising * rise * x + 3.0)
    assert plausible.gain_of_a_part(case, found) is doubtful
    assert not plausible.gain_of_a_part(case, SimpleNamespace(contribution=slope * x**2))
    assert not plausible.gain_of_a_part(case, SimpleNamespace(contribution=0.6 * whole))


@pytest.mark.parametrize(("share", "parts"), [(0.5, True), (1.5, False)])
def test_a_signal_that_is_no_sum_of_effects_has_one_gain(share, parts):
    """An effect that half of it follows is no part of it: its gain would play what is missing."""
    case = condition(spindle())
    rows = np.arange(len(case))
    library = hypotheses.build(case, "E_Z", rows)
    rise, other = case.array("T_bed") - 20.0, share * np.random.default_rng(3).standard_normal(rows.size)
    (first, *_), _ = decompose.decompose(3.0 * rise / rise.std() + other, library, case, rows, 0.3)
    assert bool(first.parts) == parts


@pytest.mark.parametrize(("left", "blocks", "counts"), [(0.5, 2, False), (0.5, 9, True), (1.0, 2, True)])
def test_a_few_blocks_in_which_names_extrapolate_do_not_count(left, blocks, counts):
    """Names that leave half of the rms elsewhere stand in spite of two blocks of 40, not of nine; useless ones fall."""
    n = 400
    before = np.random.default_rng(2).standard_normal(n)
    after = left * before
    after[: n // 40 * blocks] = 30.0
    starts = np.arange(0, n, n // 40)
    fold = np.repeat(np.random.default_rng(3).permuted(np.tile(np.arange(5), (8, 1)), axis=1).ravel(), n // 40)
    rows = [np.flatnonzero(fold == f) for f in range(5)]
    table = SimpleNamespace(n=n, rows=rows, stretches=[(k, k + n // 40, int(fold[k])) for k in starts])
    case = SimpleNamespace(library=SimpleNamespace(table=table))
    order = np.concatenate(rows)
    apart = holdout._without_worst_blocks(case, before[order], after[order])
    assert (apart[1] > unnamed.SMALLER * apart[0]) is counts
