"""Pooled parameters: simulated fleets whose truth is known, none of them used to choose anything."""

from __future__ import annotations

import numpy as np

from errpipe.fitting.pooling import homogeneous_groups, pooled


def machines(rng: np.random.Generator, count: int, spread: np.ndarray, noise: float) -> tuple:
    """True parameters, estimates and covariances; machine 0 is new: its estimate is five times as uncertain."""
    true = np.array([11.0, -4.0]) + rng.standard_normal((count, 2)) * spread
    sd = np.full((count, 2), noise) * rng.uniform(0.7, 1.4, (count, 2))
    sd[0] *= 5.0
    estimates = true + sd * rng.standard_normal((count, 2))
    return true, list(estimates), [np.diag(s**2) for s in sd]


def squares(spread: np.ndarray, noise: float, fleets: int = 60) -> tuple[float, float, float]:
    """Mean square error of the new machine's parameters: its own fit, the mean of the type, pooled."""
    rng, out = np.random.default_rng(31), []
    for _ in range(fleets):
        true, estimates, covariances = machines(rng, 20, spread, noise)
        together = pooled(estimates, covariances)
        assert together is not None
        shrunk, _ = together.shrunk(estimates[0], covariances[0])
        out.append([np.sum((v - true[0]) ** 2) for v in (estimates[0], together.mean, shrunk)])
    own, mean, both = np.mean(out, axis=0)
    return float(own), float(mean), float(both)


def test_a_new_machine_is_better_known_with_its_type_than_alone_or_by_its_type_alone() -> None:
    for spread in (np.array([0.3, 0.3]), np.array([1.0, 2.0]), np.array([5.0, 5.0])):
        own, mean, both = squares(spread, 0.5)
        assert both < 1.05 * min(own, mean), spread
    own, mean, both = squares(np.array([1.0, 2.0]), 0.5)
    assert both < 0.9 * min(own, mean)


def test_the_type_is_found_and_its_units_do_not_matter() -> None:
    rng = np.random.default_rng(5)
    _, estimates, covariances = machines(rng, 300, np.array([2.0, 0.5]), 0.5)
    together = pooled(estimates, covariances)
    assert together is not None
    np.testing.assert_allclose(np.sqrt(np.diag(together.spread)), [2.0, 0.5], rtol=0.2)
    scale = np.array([1e6, 1e-3])
    other = pooled([e * scale for e in estimates], [c * np.outer(scale, scale) for c in covariances])
    assert other is not None
    np.testing.assert_allclose(other.mean, together.mean * scale, rtol=1e-6)
    np.testing.assert_allclose(other.spread, together.spread * np.outer(scale, scale), rtol=1e-4)
    assert pooled(estimates[:3], covariances[:3]) is None


def test_four_machines_do_not_force_a_parameter_to_follow_the_others() -> None:
    """Independent parameters: of what four machines show of their correlations, little is believed."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        estimates = list(rng.normal([40.0, 5.0, -6.0], [8.0, 2.0, 1.0], (4, 3)))
        few = pooled(estimates, [np.diag([25.0, 1.0, 1.0])] * 4)
        assert few is not None
        size = np.sqrt(np.diag(few.spread))
        assert np.all(np.abs(few.spread) <= np.outer(size, size) * (4 / 7 + 1e-6) + np.diag(size**2))


def test_similar_machines_are_those_that_the_data_do_not_distinguish() -> None:
    estimates = [np.array([v, 0.0]) for v in (0.0, 0.1, 5.0, 5.1, 20.0)]
    assert homogeneous_groups(estimates, [0.01 * np.eye(2)] * 5) == [[0, 1], [2, 3]]


def test_a_parameter_that_is_the_same_everywhere_changes_no_other() -> None:
    """Covariances with a row of zeros have no inverse: the pseudo-inverse stands in."""
    _, estimates, covariances = machines(np.random.default_rng(5), 12, np.array([2.0, 1.0]), 0.5)
    wide = [np.append(e, 7.0) for e in estimates]
    singular = [np.pad(c, (0, 1)) for c in covariances]
    two, three = pooled(estimates, covariances), pooled(wide, singular)
    assert two is not None and three is not None
    np.testing.assert_allclose(three.mean, [*two.mean, 7.0], rtol=1e-3)
    shrunk, _ = three.shrunk(wide[0], singular[0])
    np.testing.assert_allclose(shrunk, [*two.shrunk(estimates[0], covariances[0])[0], 7.0], rtol=1e-3)
