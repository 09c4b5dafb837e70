"""One machine's history in parts: each is read, cleaned and passed over where it lies; one fit to all of them.

A pass over a part gives sums of products, counts and the part's rows of the sample. They are joined in the order of
the fleet file, so that the result does not depend on how many workers there are, or which of them does what.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe import jsonfile
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, ErrpipeError, UsageError
from errpipe.fitting.source import Source
from errpipe.formats import manifest_folder
from errpipe.models._base import Family, Fitted
from errpipe.pipeline import runner
from errpipe.pipeline.graph import ancestors
from errpipe.pipeline.lock import read_lock
from errpipe.pipeline.spec import Pipeline, load_pipeline
from errpipe.pipeline.stage import Context
from errpipe.stages import STAGES, _artefacts
from errpipe.stages.fit import FitStage
from errpipe.stages.validate import HELD_OUT, Validate, headline, write_rows
from errpipe.validation import held_out
from errpipe.verbs import fleet_processes
from errpipe.verbs.fleet_processes import ATTEMPTS, MACHINES, Task

WHOLE = "whole"  # folder of the results, below OUT
LOOKS = 2.0  # s between two looks at whether the workers that a part waits for are still there
PATIENCE = 60.0  # s for which a part whose workers are gone waits for one that replaces them
Map = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[tuple[str, Any]]]  # over the parts, in order


@dataclass(frozen=True)
class Parts(Source):
    """All parts as one recording. passes: carries a function out over each part; found: what each part states."""

    passes: Callable[..., list[Any]] = lambda *_: []
    found: tuple[Source, ...] = ()
    digests: tuple[str, ...] = ()
    changes: tuple[Callable[[Source], Source], ...] = ()

    def over(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """What a function of a source and further arguments gives for each part, in their order."""
        at = np.cumsum([0, *(part.rows for part in self.found)]).tolist()
        common = (self.ends, self.complete, self.changes, function, arguments)
        return self.passes(_call_on_part, [(d, a, *common) for d, a in zip(self.digests, at, strict=False)])

    def mapped(self, change: Callable[[Source], Source]) -> Source:
        """The source with a change to each part."""
        return replace(self, changes=(*self.changes, change))


# ---------------------------------------------------------------- on a worker


def _try_on_part(function: Callable[..., Any], task: Task, stage: str, *arguments: Any) -> tuple[str, Any]:
    """(why it failed, or "", and the result) of a function of one part."""
    try:
        return "", function(task, stage, *arguments)
    except ErrpipeError as err:
        return str(err).replace(task[3], "OUT"), None
    except OSError as err:  # a full disk, a share that went away
        return (f"{err.filename}: {err.strerror.lower()}" if err.filename and err.strerror else str(err)), None
    except MemoryError:
        return "out of memory", None


def _unseen_inputs(task: Task, stage: str) -> str:
    """Which inputs of a part cannot be seen from here; "" if all can."""
    try:
        spec = load_pipeline(Path(task[0]), STAGES, sets=task[2])
        selected = [spec.stage(name) for name in ancestors(spec.links, [stage])]
        return ", ".join(f"{path} does not exist" for s in selected for path in s.inputs() if not path.exists())
    except (ErrpipeError, OSError) as err:
        return str(err)


def _cleaned(task: Task, stage: str) -> tuple[Path, str]:
    """The recording of a part, brought up to date, and the SHA-256 of its rows."""
    pipeline, name, sets, out = task
    folder = Path(out) / MACHINES / name
    runner.run(load_pipeline(Path(pipeline), STAGES, sets=sets), folder, to=stage)
    return folder / stage, read_lock(folder)[stage].outputs[manifest_folder.TABLE]


def _survey(task: Task, stage: str) -> tuple[Source, str]:
    """What the recording of a part states of all its rows, and their SHA-256."""
    folder, digest = _cleaned(task, stage)
    source = _artefacts.source_in(folder)
    if source is None:
        raise DataError(f"stage {stage} left no {manifest_folder.TABLE}")
    return replace(source, batches=_refuse_reading), digest


def _refuse_reading(*_: Any, **__: Any) -> Any:
    raise TypeError("a part is read by its worker")


def _call_on_part(task: Task, stage: str, digest: str, at: int, ends: Any, complete: Any, changes: Any, function: Any,
            arguments: Any) -> Any:  # fmt: skip
    """A function of a part. The part is cleaned first where another worker has done it before, whose disk is gone."""
    folder = Path(task[3]) / MACHINES / task[1]
    record = read_lock(folder).get(stage)
    known = record is not None and record.outputs.get(manifest_folder.TABLE) == digest and (folder / stage).is_dir()
    if not known and _cleaned(task, stage)[1] != digest:
        raise DataError("its recording changed meanwhile, or is not the same on two workers; run again")
    source = _artefacts.source_in(folder / stage)
    if source is None:
        raise DataError(f"{MACHINES}/{task[1]}/{stage}: its recording has gone; run again")
    source = replace(source, ends=ends, complete=complete, at=at)
    for change in changes:
        source = change(source)
    return function(source, *arguments)


# ---------------------------------------------------------------- where the fleet was called


def in_processes(tasks: Sequence[Task], stage: str, jobs: int) -> Map:
    """Passes in processes of this machine; what a killed one was doing is tried again."""

    def mapped(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[tuple[str, Any]]:
        results: dict[int, tuple[str, Any]] = {}
        for _ in range(ATTEMPTS):
            pool_of = (jobs or None, fleet_processes.start_imports(), fleet_processes.prepare, (dict(os.environ),))
            missing = [k for k in range(len(tasks)) if k not in results]
            with suppress(BrokenProcessPool), ProcessPoolExecutor(*pool_of) as pool:
                running = {k: pool.submit(_try_on_part, function, tasks[k], stage, *arguments[k]) for k in missing}
                for k, future in running.items():
                    results[k] = future.result()
        return [results.get(k, (KILLED, None)) for k in range(len(tasks))]

    return mapped


KILLED = f"its worker was killed {ATTEMPTS} times (out of memory?)"


def on_cluster(tasks: Sequence[Task], stage: str, client: Any) -> Map:
    """Passes by those workers of a Dask cluster that can read the part's recording."""

    def places(k: int, patience: float) -> set[str]:
        end = time.monotonic() + patience
        while True:
            seen = client.run(_unseen_inputs, tasks[k], stage, on_error="ignore")
            found = {address for address, why in seen.items() if why == ""}
            if found:
                return found
            if time.monotonic() >= end:
                why = next((why for why in seen.values() if isinstance(why, str)), "there is no worker")
                raise DataError(f"{tasks[k][1]}: no worker of the cluster can read it: {why}")
            time.sleep(LOOKS)

    def mapped(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[tuple[str, Any]]:
        from distributed import KilledWorker, wait

        def submit(k: int, patience: float = 0.0) -> tuple[Any, int, set[str]]:
            at, call = places(k, patience), (function, tasks[k], stage, *arguments[k])
            return client.submit(_try_on_part, *call, pure=False, workers=sorted(at), retries=ATTEMPTS - 1), k, at

        results: dict[int, tuple[str, Any]] = {}
        running = [submit(k) for k in range(len(tasks))]
        while running:
            with suppress(TimeoutError), client.as_current():
                wait([future for future, _, _ in running], timeout=LOOKS, return_when="FIRST_COMPLETED")
            workers = client.ncores().keys()
            for entry in list(running):
                future, k, at = entry
                if future.done():
                    with suppress(TimeoutError):  # a result whose worker was killed before it was sent is pending again
                        killed = isinstance(future.exception(PATIENCE), KilledWorker)
                        results[k] = (KILLED, None) if killed else future.result(PATIENCE)
                if k not in results:
                    if at & workers:
                        continue
                    future.cancel()  # the workers that it was given to are gone; their successors have other addresses
                    running.append(submit(k, PATIENCE))
                running.remove(entry)
        return [results[k] for k in range(len(tasks))]

    return mapped


def fitted_stages(spec: Pipeline) -> tuple[list[FitStage], str]:
    """The fits of a pipeline, and the stage whose recording they read. Raises UsageError if that is not one."""
    fits = [s for s in spec.stages if isinstance(s, FitStage)]
    read = {name for fit in fits for name in spec.links[fit.label]["recording"]}
    if len(read) != 1:
        raise UsageError(f"{spec.file}: `one_machine` needs a fit, and one recording that all fits read")
    return fits, read.pop()


def fit_together(
    tasks: Sequence[Task], spec: Pipeline, mapped: Map, progress: Callable[[float, str], None]
) -> dict[str, Any]:
    """One fit, and its validation, of all parts; written below OUT/whole once all are there.

    Raises DataError with the part's name, UsageError where parts ask for different fits.
    """
    fits, stage = fitted_stages(spec)
    _refuse_other_keys(tasks, spec)

    def passes(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        done = mapped(function, arguments)
        for task, (why, _) in zip(tasks, done, strict=True):
            if why:
                raise DataError(f"{task[1]}: {why}")
        return [value for _, value in done]

    progress(0.1, f"{stage} of {len(tasks)} parts")
    source = _joined(passes(_survey, [()] * len(tasks)), [task[1] for task in tasks], passes)
    validates = [s for s in spec.stages if isinstance(s, Validate)]
    results: list[tuple[FitStage, Family, Fitted, list[tuple[Validate, Any]]]] = []
    for fit in fits:
        progress(0.5, fit.label)
        family = fit.family_options()
        if not family.in_batches(replace(source, rows=max(source.rows, 1 << 62))):
            raise DataError(f"{fit.label}: this fit needs all rows at once, and cannot be one of several parts")
        fitted = family.fit_batches(source)
        progress(0.8, fit.label)
        own = [v for v in validates if fit.label in spec.links[v.label].get("error_model", ())]
        judged = [(v, held_out.cross_validate_in_batches(source, family, v.holdout)) for v in own]
        results.append((fit, family, fitted, judged))
    out, summary = Path(tasks[0][3]) / WHOLE, {}
    for fit, family, fitted, judged in results:  # nothing is written before all are there
        inputs = jsonfile.fingerprint([source.digests, family.model_dump(mode="json")])
        context = _context(out / fit.label, inputs, spec.title)
        model = _artefacts.write_model(context, source.ends, fitted.model, family)
        for name, document in fitted.documents.items():
            context.write_json(name, document)
        summary[fit.label] = dict(fitted.summary)
        for validate, (document, rows) in judged:
            context = _context(out / validate.label, inputs, spec.title)
            document |= {"model": _artefacts.fingerprint_of(model), "inputs": inputs}
            context.write_json(_artefacts.VALIDATION, document)
            write_rows(context.folder / HELD_OUT, rows)
            summary[validate.label] = {c["component"]: headline(c) for c in document["components"]}
    parts = [{"name": task[1], "rows": f.rows} for task, f in zip(tasks, source.found, strict=True)]
    return {"parts": parts, "rows": source.rows, WHOLE: summary}


def _refuse_other_keys(tasks: Sequence[Task], spec: Pipeline) -> None:
    """Raise UsageError for a part that sets keys of a fit or a validation otherwise than the first: they are common."""
    common = [s for s in spec.stages if isinstance(s, (FitStage, Validate))]
    for task in tasks[1:]:
        own = load_pipeline(Path(task[0]), STAGES, sets=task[2])
        if differ := [s.label for s in common if own.stage(s.label) != s]:
            raise UsageError(
                f"{spec.file}: part {task[1]} sets keys of {', '.join(differ)} otherwise than {tasks[0][1]} (allowed: "
                "the same for all parts, for there is one fit)"
            )


def _context(folder: Path, inputs: str, title: str) -> Context:
    folder.mkdir(parents=True, exist_ok=True)
    return Context(folder, inputs, title)


def _joined(parts: Sequence[tuple[Source, str]], names: Sequence[str], passes: Callable[..., list[Any]]) -> Parts:
    """All parts as one. Raises DataError where their columns differ, or a run has rows in two of them."""
    found, digests = zip(*parts, strict=True)
    first, runs = found[0].manifest, dict[str, int]()
    for name, part in zip(names, found, strict=True):
        for kind in ("columns", "constants"):
            own, other = getattr(part.manifest, kind), getattr(first, kind)
            if differ := sorted(n for n in own.keys() | other.keys() if own.get(n) != other.get(n)):
                raise DataError(f"{name}: {kind} differ from those of {names[0]}: {', '.join(differ)}")
        if twice := sorted(runs.keys() & (part.runs or {}).keys()):
            raise DataError(f"{name}: run {twice[0]} has rows in an earlier part, too (allowed: whole runs)")
        runs |= part.runs or {}
    known = all(part.runs is not None for part in found)
    complete = frozenset.intersection(*(part.complete for part in found))
    values: Mapping[str, Any] = {n: pd.concat([p.ends.frame[n] for p in found]).dropna() for n in found[0].ends.frame}
    ends = {n: [v.min(), v.max()] if len(v) else [np.nan, np.nan] for n, v in values.items()}
    whole = Recording(first, pd.DataFrame(ends))
    rows = sum(part.rows for part in found)
    return Parts(rows, whole, _refuse_reading, complete, runs if known else None, 0, passes, found, digests)
