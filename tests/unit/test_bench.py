"""What `make bench` calls slower than the last run: more than the spread, relative to a peer where there is one."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from bench import __main__ as bench
from bench.figure import Figure


def run(**values: Figure) -> dict:
    return {name: {"peak_mb": 1, "figures": [asdict(figure)]} for name, figure in values.items()}


def test_a_busier_machine_is_no_slower_program_and_a_second_look_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    def seconds(value: float, times: float | None = None, spread: float = 0.0) -> Figure:
        return Figure("what", value, "s", spread, peer="python", times=times)

    old = run(busy=seconds(0.0597, 0.293), slow=seconds(1.0, 0.5), noisy=seconds(1.0, spread=0.3), alone=seconds(1.0))
    new = run(busy=seconds(0.0772, 0.285), slow=seconds(1.2, 0.4), noisy=seconds(1.3), alone=seconds(1.2))
    ratio = {"last": Figure("x", 1.9, "x", at_least=True), "now": Figure("x", 1.7, "x", at_least=True)}
    old, new = old | run(ratio=ratio["last"]), new | run(ratio=ratio["now"])
    assert [name for name, _ in bench.slower(old, new)] == ["slow", "alone", "ratio"]
    looks = {"slow": new["slow"], "alone": old["alone"], "ratio": None}  # a bench that breaks keeps what it said
    monkeypatch.setattr(bench, "measure", looks.__getitem__)
    assert [line.partition(":")[0] for line in bench.confirmed(old, new)] == ["slow", "ratio"]
