"""Two names that stand for one effect between them are not stated as two."""

from types import SimpleNamespace

import numpy as np
import pytest

from errpipe.diagnosis import gains, plausible, report
from errpipe.terms import search_of
from errpipe.terms.clock_offset import ClockOffset
from errpipe.terms.dead_time import DeadTime
from errpipe.terms.stribeck_friction import StribeckFriction

from .machines import trace


def found(contribution: np.ndarray, effect: str = "thermal_drift") -> SimpleNamespace:
    return SimpleNamespace(contribution=contribution, hypothesis=SimpleNamespace(effect=effect, drivers=("T",)))


def response(y: np.ndarray, recal: np.ndarray, gain: float = 0.0) -> SimpleNamespace:
    """A response whose simulation holds a thermal lag; `gain` of every column of its recalibration."""
    part = SimpleNamespace(hypothesis=SimpleNamespace(effect="thermal_lag", drivers=("T",)))
    scene = SimpleNamespace(coefficients=lambda: np.full(recal.shape[1], gain))
    search, held = SimpleNamespace(scene=lambda _: scene), SimpleNamespace(parts=(part,))
    return SimpleNamespace(y=y, recal=recal, search=search, decomposition=held, chosen=list)


@pytest.mark.parametrize(("size", "cancel"), [(3.0, True), (1.2, False)])
def test_two_findings_far_larger_than_the_mismatch_cancel(size, cancel):
    """Also where a gain of the simulation plays most of either: a step less a slower step is a spike."""
    rng = np.random.default_rng(3)
    step, spike, left = rng.standard_normal((3, 900))
    case = response(spike, np.column_stack([np.ones(900), step + 0.3 * left]))
    made = [found(size * step), found(spike - size * step)]
    assert plausible.cancelling(case, made) == (made[1:] if cancel else [])


def test_a_finding_that_a_gain_cancels_stays_with_another():
    rng = np.random.default_rng(4)
    large, other = rng.standard_normal((2, 900))
    case = response(other, large[:, None], -5.0)
    assert plausible.cancelling(case, [found(5.0 * large), found(other)]) == []


@pytest.mark.parametrize(
    ("size", "effect", "cancel"),
    [(3.0, "thermal_lag", True), (1.2, "thermal_lag", False), (3.0, "thermal_drift", False)],
)
def test_an_effect_of_the_simulation_is_not_taken_out_by_its_gain_and_added_in_another_form(size, effect, cancel):
    """A simulated signal that was smoothed: its dry friction got a gain of 0, and dry friction was missing."""
    part, left = np.random.default_rng(5).standard_normal((2, 900))
    name = found(size * part + left, effect)
    assert plausible.cancelling(response(left, part[:, None], -size), [name]) == ([name] if cancel else [])


@pytest.mark.parametrize(("late", "second"), [({"column": "F_sim"}, True), ({"axis": "X"}, False)])
def test_a_signal_is_late_or_early_and_not_both(monkeypatch, late, second):
    """Two shifts of a smoothed signal imitate its bends; an axis may be late beside it."""
    terms = DeadTime(**late), ClockOffset(column="F_sim")
    made = [SimpleNamespace(hypothesis=SimpleNamespace(terms=(t,))) for t in terms]
    for rule in ("at_its_limit", "implausible_size", "cancelling"):
        monkeypatch.setattr(plausible, rule, lambda *_: [])
    monkeypatch.setattr(plausible.model, "fit_finding", lambda case, k: made[k])
    case = SimpleNamespace(explanation=SimpleNamespace(accepted=[None, None]))
    assert plausible.impossible(case) == (made[1:] if second else [])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("agreement", "again", "left", "shapes", "most"),
    [
        (0.2, True, 0.1, 0.0, 0.75),
        (0.6, True, 0.45, 0.05, 1.0),
        (0.0, False, 0.1, 0.0, 1.0),
        (1.0, True, 0.45, 0.2, 0.75),
        (1.0, True, 0.14, 0.2, 1.0),
    ],
)
def test_a_name_that_folds_do_not_find_again_or_that_leaves_a_shape_is_not_sure(
    monkeypatch, agreement, again, left, shapes, most
):
    """What acts in part is not searched for in the folds; a shape in the little that a name leaves says nothing."""
    for name in ("gain_of_a_part", "only_a_wave_in_time", "is_insignificant"):
        monkeypatch.setattr(plausible, name, lambda *_: False)
    monkeypatch.setattr(report, "only_steps", lambda _: False)
    held = SimpleNamespace(names=left, before=1.0, again=again, shape_share=lambda: shapes)
    indicators = [SimpleNamespace(agreement=agreement, gain=600.0, wandering=0.0)]
    search = SimpleNamespace(scene=lambda _: SimpleNamespace(coefficients=lambda: np.zeros(2)))
    nuisances = {"nuisances": [gains.DATUM, gains.WHOLE], "sizes": np.ones(2), "chosen": list, "search": search}
    case = SimpleNamespace(held=held, over_noise=np.inf, of_a_twin=False, **nuisances)
    assert report._confidence_limits(case, [SimpleNamespace()], indicators, np.zeros(3)) == [most]
    monkeypatch.setattr(plausible, "is_insignificant", lambda *_: True)  # on a stretch that was also searched for
    for mask, limit in ((), report.UNSIZED), (("range", "x", 0.0, 5.0), report.UNPROVED):
        made = SimpleNamespace(hypothesis=SimpleNamespace(mask=mask))
        assert report._confidence_limits(case, [made], indicators, np.zeros(3)) == [limit]


@pytest.mark.parametrize(("low", "nothing"), [(-1.0, True), (0.5, False)])
def test_a_size_whose_stated_interval_spans_zero_may_be_none(low, nothing):
    """Stretches of rows may widen the interval of a size that rows alone make significant."""
    made = SimpleNamespace(joint=50.0, cores=1, estimates=(SimpleNamespace(low=low, high=9.0),))
    assert plausible.is_insignificant(made) is nothing


@pytest.mark.parametrize(("form", "in_doubt"), [("any shape", 0), ("textbook", 1)])
def test_of_any_shape_the_textbook_form_may_have_no_size(monkeypatch, form, in_doubt):
    term = SimpleNamespace(form=form, nonlinear=tuple)
    made = SimpleNamespace(joint=0.1, cores=1, estimates=(SimpleNamespace(name="a", low=-1.0, high=9.0),))
    made.hypothesis = SimpleNamespace(terms=(term,), nonlinear=((),))
    monkeypatch.setattr(plausible.model, "fit_finding", lambda case, k: made)
    case = SimpleNamespace(explanation=SimpleNamespace(accepted=[None]))
    assert len(plausible.doubtful(case)) == in_doubt


@pytest.mark.parametrize(("low", "axes", "nothing"), [(-2.0, 1, True), (0.5, 1, False), (-2.0, 2, False)])
def test_a_curve_of_which_no_coefficient_is_known_has_no_size(low, axes, nothing):
    """Collinear polynomials over half an axis are significant together, and each of them may be zero.

    Of one term on two axes only the difference may be known.
    """
    bows = tuple(SimpleNamespace(low=v, high=9.0) for v in (-8.0, low, -7.0))
    hypothesis = SimpleNamespace(terms=(None,) * axes)
    assert (
        plausible.is_insignificant(SimpleNamespace(joint=50.0, cores=3, estimates=bows, hypothesis=hypothesis))
        is nothing
    )


def test_friction_that_falls_up_to_the_highest_speed_is_at_its_limit():
    """Within 40 % of the highest speed it must have faded: beyond, dry friction looks the same."""
    case = trace(5, hidden=lambda c: 20.0 * np.sign(c["v"]))
    (column,) = case.names("velocity")
    term = StribeckFriction(axis="X", column=column)
    (speed,) = term.nonlinear()
    assert search_of(speed).limits(term, case)[1] == pytest.approx(
        0.4 * np.nanquantile(np.abs(case.array(column)), 0.999)
    )
    span = SimpleNamespace(name=speed.name, low=0.0, high=0.0)
    fastest = search_of(speed).limits(term, case)[1]
    for share, at_limit in ((1.0, True), (0.3, False)):
        span.low = span.high = share * fastest
        made = SimpleNamespace(
            hypothesis=SimpleNamespace(terms=(term,), nonlinear=((share * fastest,),)), estimates=(span,)
        )
        assert plausible.at_its_limit(SimpleNamespace(recording=case), made) is at_limit
