"""Running a pipeline: only what must run, and nothing half written.

A stage runs when its code, parameters, inputs or sources are not those of the lock file, or when an
output is missing or was edited. It works in a scratch folder; what it wrote is then moved into
OUT/<stage>/ file by file (only where the bytes differ), and last the lock file is rewritten. Killed anywhere
in between, the next run finds outputs that are not those of the lock file, and runs that stage again. So only
outputs, and the lock file at the end, are waited for until they are on disk: where power fails, an older lock file
or a journal without its bytes does no harm, and each wait takes a disk as long as a small fit.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from typing import Any

from errpipe import files, jsonfile
from errpipe.errors import ConfigError, DataError, UsageError, VerifyError
from errpipe.files import inside
from errpipe.pipeline import lock
from errpipe.pipeline.graph import ancestors, upstream
from errpipe.pipeline.spec import Pipeline, missing_inputs
from errpipe.pipeline.stage import Context, Stage
from errpipe.pipeline.step import NO_CALLBACKS, Callbacks, Step


def plan(pipeline: Pipeline, out: Path, *, to: str | None = None, force: Sequence[str] = ()) -> list[Step]:
    """What `run` would do, stage by stage, with the reasons. Writes nothing. Raises ConfigError, UsageError."""
    work = _Work(pipeline, out, to, force)
    steps: list[Step] = []
    unsure: set[str] = set()
    for stage in work.selected:
        before = [name for name in upstream(pipeline.links, stage.label) if name in unsure]
        if any(name not in work.records for name in before):
            record, reasons = None, ["has not run"] if stage.label not in work.records else []
        else:
            record = work.record(stage)
            reasons = work.reasons(stage, record)
        if reasons or before:
            unsure.add(stage.label)
        action = "run" if reasons else "perhaps" if before else "fresh"
        steps.append(work.step(stage, action, reasons or [f"if {name} brings something new" for name in before]))
    return steps


def run(
    pipeline: Pipeline,
    out: Path,
    *,
    to: str | None = None,
    force: Sequence[str] = (),
    jobs: int = 1,
    callbacks: Callbacks = NO_CALLBACKS,
) -> list[Step]:
    """Bring OUT up to date; one Step per selected stage, in file order.

    to: only this stage and what it reads. force: stages to run in any case. jobs: stages at a time.
    Raises what a stage raises; stages that finished before stay recorded.
    """
    work = _Work(pipeline, out, to, force)
    with lock.exclusive_lock(out, callbacks.waiting):
        work.records = lock.read_lock(out)
        work.remove_leftovers()
        try:
            steps = _in_order(work, callbacks) if jobs <= 1 else _side_by_side(work, callbacks, jobs)
        finally:
            shutil.rmtree(lock.scratch(out) / "work", ignore_errors=True)
        if to is None:
            work.drop_removed_stages()
        lock.write_lock(out, work.records)
        if any(step.action == "run" for step in steps):
            files.to_disk(out / lock.LOCK)
    return steps


def _in_order(work: _Work, callbacks: Callbacks) -> list[Step]:
    steps = []
    for stage in work.selected:
        record = work.record(stage)
        reasons = work.reasons(stage, record)
        if reasons:
            callbacks.started(work.step(stage, "run", reasons))
            steps.append(work.finish(stage, reasons, *work.execute(stage, record, callbacks)))
        else:
            steps.append(work.step(stage, "fresh", ()))
        callbacks.finished(steps[-1])
    return steps


def _side_by_side(work: _Work, callbacks: Callbacks, jobs: int) -> list[Step]:
    """Like `_in_order`, with up to `jobs` stages at a time; all bookkeeping stays in this thread."""
    steps: dict[str, Step] = {}
    running: dict[Future[Any], tuple[Stage, list[str]]] = {}
    waiting = list(work.selected)
    failures: dict[int, BaseException] = {}
    with ThreadPoolExecutor(max_workers=jobs) as pool:
        while waiting or running:
            for stage in list(waiting):
                ready = all(name in steps for name in upstream(work.pipeline.links, stage.label))
                if failures or not ready or len(running) >= jobs:
                    continue
                waiting.remove(stage)
                record = work.record(stage)
                reasons = work.reasons(stage, record)
                if not reasons:
                    steps[stage.label] = work.step(stage, "fresh", ())
                    callbacks.finished(steps[stage.label])
                    continue
                callbacks.started(work.step(stage, "run", reasons))
                running[pool.submit(work.execute, stage, record, callbacks)] = (stage, reasons)
            if failures and not running:
                break
            done, _ = wait(running, return_when=FIRST_COMPLETED) if running else ((), ())
            for future in done:
                stage, reasons = running.pop(future)
                error = future.exception()
                if error is not None:
                    failures[work.selected.index(stage)] = error
                    continue
                steps[stage.label] = work.finish(stage, reasons, *future.result())
                callbacks.finished(steps[stage.label])
    if failures:
        raise failures[min(failures)]
    return [steps[stage.label] for stage in work.selected]


class _Work:
    """One run (or plan) over one OUT."""

    def __init__(self, pipeline: Pipeline, out: Path, to: str | None, force: Sequence[str]):
        self.pipeline, self.out = pipeline, Path(out)
        self.force = {pipeline.stage(name).label for name in force}
        wanted = ancestors(pipeline.links, [pipeline.stage(to).label]) if to is not None else None
        self.selected = [stage for stage in pipeline.stages if wanted is None or stage.label in wanted]
        if self.out.exists() and not self.out.is_dir():
            raise UsageError(f"{out}: is a file (a folder for the outputs is needed)")
        self._look_at_inputs()
        self.records = lock.read_lock(self.out)

    def _look_at_inputs(self) -> None:
        missing = missing_inputs(self.pipeline, self.selected)
        if missing:
            raise ConfigError(missing)
        resolved = self.out.resolve()
        for stage in self.selected:
            for path in stage.inputs():
                if path.is_dir() and resolved.is_relative_to(path.resolve()):
                    raise UsageError(f"{self.out}: lies inside {path}, which stage {stage.label} reads")

    def record(self, stage: Stage) -> lock.Record:
        """The present record of a stage, without outputs: hashes every input."""
        inputs = {label: lock.hash_file(path) for label, path in lock.label_inputs(stage.inputs()).items()}
        taken = {need.type for need in stage.takes.values()}
        for name in upstream(self.pipeline.links, stage.label):
            outputs = self.records[name].outputs if name in self.records else {}
            unread = {f for f, kind in self.pipeline.stage(name).file_types.items() if kind not in taken}
            inputs |= {f"{name}/{file}": digest for file, digest in outputs.items() if file not in unread}
        sources = {slot: list(names) for slot, names in self.pipeline.links[stage.label].items()}
        return lock.Record(stage.kind, lock.code_of(stage), stage.parameters(), sources, inputs)

    def reasons(self, stage: Stage, new: lock.Record) -> list[str]:
        """Why the stage must run; [] where it need not."""
        old = self.records.get(stage.label)
        if old is None:
            return ["has not run"]
        texts = ["forced"] if stage.label in self.force else []
        texts += lock.changes(old, new)
        if self._journal(stage).is_file():
            texts.append("interrupted while its outputs were put in place")
        for file, digest in sorted(old.outputs.items()):
            path = inside(self.out, f"{stage.label}/{file}", VerifyError)
            if not path.is_file():
                texts.append(f"output {file} is missing")
            elif lock.hash_file(path) != digest:
                texts.append(f"output {file} was edited")
        return texts

    def _journal(self, stage: Stage) -> Path:
        """Names of outputs that may be in place before the lock file lists them; deleted afterwards."""
        return lock.scratch(self.out) / f"{stage.label}.json"

    def execute(self, stage: Stage, record: lock.Record, callbacks: Callbacks) -> tuple[lock.Record, Path]:
        """Run the stage in its scratch folder; the full record and that folder. Raises what the stage raises."""
        folder = lock.scratch(self.out) / "work" / stage.label
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        links = self.pipeline.links[stage.label]
        context = Context(
            folder=folder,
            fingerprint=record.fingerprint,
            title=self.pipeline.title,
            stages={slot: {name: self.out / name for name in names} for slot, names in links.items()},
            progress=lambda fraction, text: callbacks.progress(stage.label, fraction, text),
        )
        with files.scratch():
            summary = dict(stage.run(context) or {})
        jsonfile.dumps(summary)  # raises before anything is published where a stage's summary cannot be written
        outputs = {
            path.relative_to(folder).as_posix(): lock.hash_file(path)
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }
        lacking = sorted(set(stage.outputs()) - set(outputs))
        if lacking:
            raise RuntimeError(f"stage {stage.label} did not write {', '.join(lacking)}")
        for label, path in lock.label_inputs(stage.inputs()).items():
            if record.inputs.get(label) != lock.hash_file(path):
                raise DataError(f"{path}: changed while stage {stage.label} was reading it; run again")
        return replace(record, outputs=outputs, summary=summary), folder

    def finish(self, stage: Stage, reasons: Sequence[str], record: lock.Record, folder: Path) -> Step:
        """Move the outputs to their place and write the lock file."""
        own = self.out / stage.label
        journal = self._journal(stage)
        old = self.records.get(stage.label)
        stale = set(old.outputs if old else {}) | set(_names_in(journal))
        if set(record.outputs) - stale:
            with files.scratch():
                jsonfile.write(journal, sorted(stale | set(record.outputs)))
        places = {name: inside(self.out, f"{stage.label}/{name}", VerifyError) for name in stale | set(record.outputs)}
        written = [name for name in sorted(record.outputs) if _publish(folder / name, places[name])]
        for name in sorted(stale - set(record.outputs)):
            _remove(own, name)
        self.records[stage.label] = record
        with files.scratch():
            lock.write_lock(self.out, self.records)
        journal.unlink(missing_ok=True)
        return replace(self.step(stage, "run", reasons), written=tuple(written))

    def step(self, stage: Stage, action: str, reasons: Sequence[str]) -> Step:
        record = self.records.get(stage.label)
        outputs, summary = (tuple(sorted(record.outputs)), record.summary) if record else ((), {})
        return Step(stage.label, stage.kind, action, tuple(reasons), outputs, (), summary)

    def remove_leftovers(self) -> None:
        """Remove what an interrupted run left half written."""
        shutil.rmtree(lock.scratch(self.out) / "work", ignore_errors=True)
        for folder in (self.out, lock.scratch(self.out)):
            for path in folder.glob(".*.tmp"):
                path.unlink(missing_ok=True)

    def drop_removed_stages(self) -> None:
        """Drop stages that the pipeline no longer has, and their outputs where they were not edited."""
        names = {stage.label for stage in self.pipeline.stages}
        for name in [name for name in self.records if name not in names]:
            for file, digest in self.records.pop(name).outputs.items():
                path = inside(self.out, f"{name}/{file}", VerifyError)
                if path.is_file() and lock.hash_file(path) == digest:
                    _remove(self.out / name, file)


def _publish(source: Path, target: Path) -> bool:
    """Move one file to its place, whole and on disk; only where the bytes differ. True if moved."""
    if (
        target.is_file()
        and target.stat().st_size == source.stat().st_size
        and lock.hash_file(target) == lock.hash_file(source)
    ):
        return False
    target.parent.mkdir(parents=True, exist_ok=True)
    files.to_disk(source)
    os.chmod(source, 0o644)
    os.replace(source, target)
    return True


def _names_in(journal: Path) -> list[str]:
    """Files that an interrupted run may have moved to their place without recording them; none where power failed."""
    names = jsonfile.read(journal) if journal.is_file() and journal.stat().st_size else []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise VerifyError(f"{journal}: is not a list of names; it was not written by errpipe")
    for name in names:
        lock.refuse_outside(journal, name)
    return names


def _remove(folder: Path, name: str) -> None:
    """Remove a file and the folders it leaves empty."""
    path = folder / name
    path.unlink(missing_ok=True)
    for parent in path.parents:
        if not parent.is_relative_to(folder):
            return
        try:
            parent.rmdir()
        except OSError:
            return
