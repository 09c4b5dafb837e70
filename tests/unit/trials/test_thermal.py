"""Thermal trial machines: the physics is right, seeds give the same bytes, the judge counts as the page says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.formats import manifest_folder
from trials import folder
from trials.thermal.__main__ import geometric, markdown
from trials.thermal.baselines import predictions, since_start
from trials.thermal.machines import KINDS, Machine
from trials.thermal.seasons import machine_of, recordings


def one_body() -> Machine:
    one = np.ones(1)
    return Machine(
        "one", 1000.0 * one, np.zeros((1, 1)), 2.0 * one, 0 * one, 50.0 * np.ones((1, 1)), one, np.array([0])
    )


def test_one_body_warms_as_the_book_says() -> None:
    rows = 400
    theta = one_body().march(10.0, np.ones((rows, 1)), np.zeros(rows), np.full(rows, 20.0))
    t = 10.0 * np.arange(rows)
    np.testing.assert_allclose(theta[:, 0], 20 + 25 * (1 - np.exp(-t / 500)), rtol=1e-9)


@pytest.mark.parametrize("kind", list(KINDS))
def test_settled_machine_gives_off_what_it_takes_in(kind: str) -> None:
    machine = KINDS[kind](np.random.default_rng(8))
    work = np.ones((3, machine.heat.shape[1]))
    theta = machine.march(1e8, work, np.ones(3), np.full(3, 20.0))[-1]
    films = machine.films * (1 + machine.windy)
    assert films @ (theta - 20) == pytest.approx(machine.heat.sum(), rel=1e-6)
    assert np.all(theta > 20) and np.all(theta < 400)


def test_march_does_not_depend_on_the_step() -> None:
    machine = KINDS["plate"](np.random.default_rng(9))
    work = np.ones((64, 2))
    coarse = machine.march(240.0, work[:16], np.full(16, 0.5), np.full(16, 22.0))
    fine = machine.march(60.0, work, np.full(64, 0.5), np.full(64, 22.0))
    np.testing.assert_allclose(coarse, fine[::4], rtol=1e-8)


def test_seed_gives_the_same_bytes_and_files_are_read(tmp_path: Path) -> None:
    for where in ("a", "b"):
        fit, judged = recordings(3, 2)
        folder.write(tmp_path / where / "fit", fit)
        folder.write(tmp_path / where / "judge", judged)
    for path in ("fit/recording.csv", "judge/recording.csv", "fit/recording.yaml"):
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()
    read = manifest_folder.read(tmp_path / "a" / "fit")
    assert set(read.frame["season"]) == {"winter", "spring"}
    assert set(manifest_folder.read(tmp_path / "a" / "judge").frame["season"]) == {"summer"}
    assert 4 <= len(read.names("temperature")) <= 6


def test_machines_differ_by_kind_and_drift_by_tens_of_micrometres() -> None:
    assert [machine_of(5, k)[0].kind for k in range(3)] == list(KINDS)
    for number in range(3):
        fit, _ = recordings(5, number)
        assert 3 < np.std(since_start(fit.values("E_Z"), fit.runs())) < 150


def test_baselines_are_better_than_nothing() -> None:
    fit, judged = recordings(6, 1)
    y = since_start(judged.values("E_Z"), judged.runs())
    left = {name: float(np.std(y - p)) for name, p in predictions(fit, judged, "E_Z").items()}
    assert max(left["least squares"], left["ridge"], left["lasso"]) < 0.6 * left["nothing"]


def test_table_counts() -> None:
    rows = [
        {
            "machine": "rod-1",
            "left": {"nothing": 1.0, "lasso": 0.1, "auto": 0.1},
            "families": {"auto": {"exported": True}},
        },
        {
            "machine": "rod-2",
            "left": {"nothing": 1.0, "lasso": 0.4, "auto": 0.9},
            "families": {"auto": {"exported": True}},
        },
    ]
    text = markdown(rows, "two")
    assert "| auto | 0.300 | 0.300 | 1 of 2 | 0.90 |" in text
    assert geometric([0.1, 0.4]) == pytest.approx(0.2)
