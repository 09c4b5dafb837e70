"""Parts of one machine's history: what cannot be joined is refused by name, and a killed process tried again."""

from __future__ import annotations

from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError, UsageError
from errpipe.fitting.source import Source
from errpipe.models._base import Fitted
from errpipe.verbs import _fleet_history
from errpipe.verbs.fleet import Fleet

COLUMNS = {"run": Column(role="run"), "EXX": Column(role="error", unit="um", component="EXX")}
TASKS = [("axis.yaml", name, [], "/o") for name in ("a", "b")]


def part(run: str, low: float, high: float, rows: int = 10) -> Source:
    ends = pd.DataFrame({"run": [run, run], "EXX": [low, high]})
    manifest = Manifest(recording=1, tables=("t.parquet",), columns=COLUMNS)
    return Source(
        rows, Recording(manifest, ends), _fleet_history._refuse_reading, frozenset({"run", "EXX"}), {run: rows}
    )


def joined(*parts: Source) -> _fleet_history.Parts:
    return _fleet_history._joined([(p, str(k)) for k, p in enumerate(parts)], ["a", "b"][: len(parts)], lambda *_: [])


def test_parts_state_what_the_whole_would() -> None:
    gaps = replace(part("2", 0.0, 4.0, 5), complete=frozenset({"run"}))
    whole = joined(part("1", -1.0, 2.0), gaps)
    assert whole.rows == 15 and whole.runs == {"1": 10, "2": 5} and whole.complete == {"run"}
    assert whole.ends.array("EXX").tolist() == [-1.0, 4.0]
    assert joined(part("1", np.nan, np.nan), gaps).ends.array("EXX").tolist() == [0.0, 4.0]
    assert joined(part("1", 0.0, 1.0), replace(gaps, runs=None)).runs is None


def test_each_part_is_given_its_first_row_in_the_whole() -> None:
    told: list[Any] = []
    parts = [part("1", 0.0, 1.0), part("2", 0.0, 1.0)]
    whole = _fleet_history._joined([(p, "-") for p in parts], ["a", "b"], lambda f, each: told.extend(each))
    whole.over(len)
    assert [arguments[1] for arguments in told] == [0, 10]


def test_a_run_in_two_parts_and_other_columns_are_refused() -> None:
    with pytest.raises(DataError, match="b: run 1 has rows in an earlier part, too"):
        joined(part("1", 0.0, 1.0), part("1", 0.0, 1.0))
    other = part("2", 0.0, 1.0)
    columns = {**COLUMNS, "T": Column(role="temperature", unit="degC")}
    manifest = Manifest(recording=1, tables=("t.parquet",), columns=columns)
    with pytest.raises(DataError, match="b: columns differ from those of a: T"):
        joined(part("1", 0.0, 1.0), replace(other, ends=Recording(manifest, other.ends.frame.assign(T=20.0))))


def test_a_pool_of_machines_is_not_one_machine() -> None:
    with pytest.raises(ValidationError, match="`pool` needs several machines"):
        Fleet.model_validate(
            {"fleet": 1, "pipeline": "p.yaml", "machines": [{"name": "a"}], "pool": True, "one_machine": True}
        )


@pytest.mark.parametrize("deaths", [1, 3])
def test_what_a_killed_process_was_doing_is_tried_again(deaths: int, monkeypatch: pytest.MonkeyPatch) -> None:
    pools: list[list[str]] = []

    class Pool:
        """Carries out one part; then its process dies, in the first pools."""

        def __init__(self, *_: Any) -> None:
            pools.append([])

        def __enter__(self) -> Pool:
            return self

        def __exit__(self, *_: Any) -> None:
            pass

        def submit(self, attempted: Any, function: Any, task: Any, *rest: Any) -> Future[Any]:
            future: Future[Any] = Future()
            pools[-1].append(task[1])
            if len(pools) <= deaths and task[1] == "b":
                future.set_exception(BrokenProcessPool())
            else:
                future.set_result(attempted(function, task, *rest))
            return future

    monkeypatch.setattr(_fleet_history, "ProcessPoolExecutor", Pool)
    passes = _fleet_history.in_processes(TASKS, "clean", 1)
    results = passes(lambda task, stage, number: (task[1], stage, number), [(1,), (2,)])
    assert results[0] == ("", ("a", "clean", 1)) and pools[1] == ["b"]
    assert results[1] == (("", ("b", "clean", 2)) if deaths < 3 else (_fleet_history.KILLED, None))


def test_a_part_that_fails_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES

    (tmp_path / "p.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: ingest, recording: raw}\n"
        "  - {kind: fit, from: {recording: ingest}, components: [{component: EXX, terms: [{term: offset}]}]}\n",
        "utf-8",
    )
    (tmp_path / "raw").mkdir()
    tasks = [(str(tmp_path / "p.yaml"), "a", [], str(tmp_path / "out"))]

    def passes(function: Any, arguments: Any) -> Any:
        return [
            _fleet_history._try_on_part(function, task, "ingest", *a) for task, a in zip(tasks, arguments, strict=True)
        ]

    spec = load_pipeline(tmp_path / "p.yaml", STAGES)
    with pytest.raises(DataError, match=r"^a: .*raw"):
        _fleet_history.fit_together(tasks, spec, passes, lambda *_: None)
    assert not (tmp_path / "out/whole").exists()


TWO_FITS = """\
pipeline: 1
stages:
  - {kind: ingest, recording: raw}
  - {kind: fit, from: {recording: ingest}, components: [{component: EXX, terms: [{term: offset}]}]}
  - {kind: fit, name: second, from: {recording: ingest}, components: [{component: EXX, terms: [{term: offset}]}]}
  - {kind: validate, from: {error_model: fit, recording: ingest}}
  - {kind: validate, name: again, from: {error_model: second, recording: ingest}}
"""


def test_nothing_is_written_before_the_last_fit_is_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from errpipe.models.terms import Terms
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES

    (tmp_path / "p.yaml").write_text(TWO_FITS, "utf-8")
    fitted: list[Any] = []

    def fit(family: Terms, source: Source) -> Any:
        if fitted:
            raise DataError("second: not determined")
        fitted.append(family)
        return Fitted(ErrorModel(components=()), {}, {})

    monkeypatch.setattr(Terms, "fit_batches", fit)
    monkeypatch.setattr(_fleet_history.held_out, "cross_validate_in_batches", lambda *_: ({"components": []}, {}))
    tasks = [(str(tmp_path / "p.yaml"), "a", [], str(tmp_path / "out"))]
    spec = load_pipeline(tmp_path / "p.yaml", STAGES)
    with pytest.raises(DataError, match="second: not determined"):
        _fleet_history.fit_together(tasks, spec, lambda *_: [("", (part("1", 0.0, 1.0), "-"))], lambda *_: None)
    assert fitted and not (tmp_path / "out").exists()


def test_parts_that_ask_for_different_fits_are_refused(tmp_path: Path) -> None:
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES

    (tmp_path / "p.yaml").write_text(TWO_FITS, "utf-8")
    sets = [["ingest.recording=a"], ["ingest.recording=b", "validate.holdout={scheme: leave-one-group-out, of: day}"]]
    tasks = [(str(tmp_path / "p.yaml"), name, s, str(tmp_path / "out")) for name, s in zip("ab", sets, strict=True)]
    spec = load_pipeline(tmp_path / "p.yaml", STAGES, sets=sets[0])
    with pytest.raises(UsageError, match="part b sets keys of validate otherwise than a"):
        _fleet_history.fit_together(tasks, spec, lambda *_: [], lambda *_: None)
    _fleet_history._refuse_other_keys([tasks[0], (*tasks[1][:2], sets[1][:1], tasks[1][3])], spec)


class _Future:
    def __init__(self, value: object) -> None:
        self.value, self.cancelled = value, False

    def done(self) -> bool:
        return True

    def exception(self, timeout: float) -> None:
        return None

    def result(self, timeout: float) -> object:
        if self.value is None:
            raise TimeoutError
        return self.value

    def cancel(self) -> None:
        self.cancelled = True


class _Cluster:
    """The worker `a` finishes its part and is killed before it sends the result; `b` replaces it."""

    def __init__(self) -> None:
        self.futures = [_Future(None), _Future(("", 5.0))]
        self.submitted: list[_Future] = []

    def run(self, *_: object, **__: object) -> dict[str, str]:
        return {"b" if self.submitted else "a": ""}

    def ncores(self) -> dict[str, int]:
        return {"b": 1}

    def submit(self, *_: object, **__: object) -> _Future:
        self.submitted.append(self.futures[len(self.submitted)])
        return self.submitted[-1]

    def as_current(self) -> AbstractContextManager[None]:
        return nullcontext()


def test_a_result_whose_worker_was_killed_before_it_was_sent_is_computed_again(monkeypatch: Any) -> None:
    """Its future was waited for without end: the scheduler computes it again only on the workers that are gone."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "wait", lambda *_, **__: None)
    cluster = _Cluster()
    mapped = _fleet_history.on_cluster([("pipeline.yaml", "p1", [], "out")], "clean", cluster)
    assert mapped(len, [()]) == [("", 5.0)]
    assert len(cluster.submitted) == 2 and cluster.submitted[0].cancelled
