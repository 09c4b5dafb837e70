"""Where the system has no flock (Windows), runs still exclude each other."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from errpipe.pipeline.lock import exclusive_lock


@pytest.mark.filterwarnings("ignore:only soft file lock")
def test_two_runs_wait_for_each_other_without_flock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fcntl", None)
    waited, order = threading.Event(), []

    def second() -> None:
        with exclusive_lock(tmp_path, waited.set):
            order.append("second")

    with exclusive_lock(tmp_path):
        other = threading.Thread(target=second)
        other.start()
        assert waited.wait(10)
        order.append("first")
    other.join(10)
    assert order == ["first", "second"]


def test_the_limits_of_an_fmu_are_left_out_where_there_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    from errpipe.simulation import fmu_worker

    monkeypatch.setitem(sys.modules, "resource", None)
    fmu_worker.limit(100, 100)
