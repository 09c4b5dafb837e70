"""`errpipe fleet`: one pipeline for many machines, in processes of their own or on a Dask cluster; one report.

Workers get paths and give back a few numbers; whatever a machine's run makes stands in OUT/machines/NAME. A machine
that fails, or whose worker dies, does not stop the others. What was finished is not run again.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import re
import time
from collections.abc import Callable, Container, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from errpipe import jsonfile, yamlfile
from errpipe.errors import ErrpipeError, NotIdentifiable, UsageError
from errpipe.yamlfile import Options

MACHINES, TIMES = "machines", "times.csv"
WORKER = "errpipe.verbs._fleet_worker"
ATTEMPTS = 3  # of a machine whose worker dies; the last one alone in its pool, so that no other can be the cause
BORROWS = "fitted with the parameters of its type as priors, for its own runs are not enough: "
NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
Progress = Callable[[float, str], None]


class FleetMachine(Options):
    """One machine of a fleet."""

    name: str = Field(pattern=NAME, description="Name of the machine and of its folder.")
    type: str = Field("", description="Machines of one type are pooled.")
    set: tuple[str, ...] = Field((), description="Keys of the pipeline for this machine, STAGE.KEY=VALUE.")


class Fleet(Options):
    """A pipeline, and the machines that it is run for."""

    fleet: Literal[1] = Field(description="Version of the fleet format.")
    title: str = Field("", description="One line for people.")
    pipeline: str = Field(description="The pipeline file, relative to this file.")
    recordings: str | None = Field(
        None, description="Folder with one recording folder per machine, relative to this file: all are the fleet's."
    )
    stage: str = Field("ingest", description="Stage that reads a machine's recording.")
    machines: tuple[FleetMachine, ...] = Field((), description="Machines that need their own keys or a type.")
    pool: bool = Field(False, description="Draw the parameters of each machine towards those of its type.")

    @model_validator(mode="after")
    def _some(self) -> Fleet:
        if self.recordings is None and not self.machines:
            raise ValueError("`recordings` or `machines` is needed")
        names = [m.name.lower() for m in self.machines]
        if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
            raise ValueError(f"two machines have one name: {', '.join(twice)} (small and capital letters are one)")
        return self


def fleet(
    file: Path, out: Path, jobs: int = 0, scheduler: str | None = None, progress: Progress = lambda share, text: None
) -> dict[str, Any]:
    """Run every machine, then write the report. Returns its document with times and memory.

    jobs: processes, 0 for one per core; scheduler: address of a running Dask cluster instead. Raises ConfigError,
    UsageError; what goes wrong with one machine stands in the document.
    """
    if not scheduler:
        _start_imports()
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES
    from errpipe.verbs._fleet_report import model_of, write_report
    from errpipe.verbs._fleet_types import borrowing

    spec: Fleet = yamlfile.load(Path(file), Fleet)
    root = Path(file).parent.absolute()
    pipeline = root / spec.pipeline
    tasks = [(str(pipeline), m.name, list(m.set), str(Path(out).absolute())) for m in machines_of(spec, root)]
    if spec.recordings is not None and Path(out).resolve().is_relative_to((root / spec.recordings).resolve()):
        raise UsageError(f"{out}: inside {spec.recordings}, where it would be read as a machine")
    _refuse_for_all(lambda sets: load_pipeline(pipeline, STAGES, sets=sets), [task[2] for task in tasks])
    types = {m.name: m.type for m in machines_of(spec, root)}
    results: dict[str, dict[str, Any]] = {}
    models: dict[str, Future[Any]] = {}

    def run(some: Sequence[Task]) -> None:
        for result in _on_cluster(some, scheduler) if scheduler else _in_processes(some, jobs):
            name = result["name"]
            results[name], models[name] = result, reader.submit(model_of, result)
            progress(len(results) / len(tasks), f"{name}: {result['state']}")

    with ThreadPoolExecutor(1) as reader:  # models are checked while other machines run
        reader.submit(importlib.import_module, "errpipe.fitting.pooling")  # for the report, while workers import
        run(tasks)
        undetermined = [name for name, result in results.items() if result.get("undetermined")] if spec.pool else []
        if undetermined:
            own = {name: model.result() for name, model in models.items()}
            why = {name: results[name]["message"].partition(f"; {MACHINES}/")[0] for name in undetermined}
            run(again := borrowing(tasks, undetermined, results, own, types))
            for _, name, *_ in again:
                results[name]["borrows"] = results[name]["state"] != "failed"
                if results[name]["borrows"]:
                    results[name]["message"] = "; ".join(filter(None, (results[name]["message"], BORROWS + why[name])))
        read = {name: model.result() for name, model in models.items()}
    ordered = [results[task[1]] for task in tasks]
    document = write_report(spec.title, spec.pool, types, ordered, read, Path(out))
    rows = [f"{r['name']},{r['seconds']:.2f},{r['peak_mb']:.0f},{r['attempts']}" for r in ordered]
    jsonfile.write_text(Path(out) / TIMES, "\n".join(["machine,seconds,peak_mb,attempts", *rows, ""]))
    return document | {"times": {r["name"]: {k: r[k] for k in ("seconds", "peak_mb", "attempts")} for r in ordered}}


def _refuse_for_all(load: Callable[[list[str]], object], machines: list[list[str]]) -> None:
    """Raise the first machine's error where the pipeline can be read with the keys of none: reported once."""
    first: ErrpipeError | None = None
    for sets in machines:
        try:
            load(sets)
            return
        except ErrpipeError as err:
            first = first or err
    if first is not None:
        raise first


def machines_of(spec: Fleet, root: Path) -> list[FleetMachine]:
    """The machines that are listed, and every folder of recordings; a listed one brings its type and keys."""
    listed = {m.name: m for m in spec.machines}
    if spec.recordings is None:
        return list(spec.machines)
    folder = root / spec.recordings
    if not folder.is_dir():
        raise UsageError(f"{folder}: there is no such folder (recordings of the fleet)")
    names = sorted(p.name for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    absent = [name for name in listed if name not in names]
    if absent or not names:
        raise UsageError(f"{folder}: holds no recording of {', '.join(absent) or 'any machine'}")
    if odd := [name for name in names if not re.fullmatch(NAME, name)]:
        raise UsageError(
            f"{folder}: no name of a machine: {', '.join(odd)} (allowed: letters, digits, '.', '_' and '-')"
        )
    lower = [name.lower() for name in names]
    if twice := [name for name in names if lower.count(name.lower()) > 1]:
        raise UsageError(
            f"{folder}: two machines have one name: {', '.join(twice)} (small and capital letters are one)"
        )
    out = []
    for name in names:
        machine = listed.get(name) or FleetMachine(name=name)
        path = jsonfile.dumps((folder / name).as_posix(), indent=None).strip()
        out.append(machine.model_copy(update={"set": (f"{spec.stage}.recording={path}", *machine.set)}))
    return out


def run_machine(pipeline: str, name: str, sets: Sequence[str], out: str) -> dict[str, Any]:
    """One machine's pipeline, in this process: what became of it, seconds and the peak of its memory, MB.

    Never raises: one machine's failure is a result.
    """
    from errpipe.pipeline import runner
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES
    from errpipe.verbs._fleet_report import facts

    begin, state, message = time.perf_counter(), "done", ""
    figures: dict[str, Any] = {"responses": {}, "drift": [], "model": "", "undetermined": False}
    folder, brought_up_to_date = Path(out) / MACHINES / name, set()
    callbacks = runner.Callbacks(finished=lambda step: brought_up_to_date.add(step.name))
    _reset_peak()
    try:
        spec = load_pipeline(Path(pipeline), STAGES, sets=sets)
        runner.run(spec, folder, callbacks=callbacks)
        figures = facts(spec, folder)
    except ErrpipeError as err:
        state, message = ("refused" if err.exit_code == 4 else "failed"), str(err).replace(out, "OUT")
        figures["undetermined"] = isinstance(err, NotIdentifiable)
    except Exception as err:
        state, message = "failed", f"internal error, please report it: {type(err).__name__}: {err}"
    message += _of_earlier(folder, brought_up_to_date) if state != "done" else ""
    seconds = time.perf_counter() - begin
    result = {"name": name, "state": state, "message": message, "attempts": 1, "seconds": seconds}
    return figures | result | {"peak_mb": _peak_mb()}


def _of_earlier(folder: Path, brought_up_to_date: Container[str]) -> str:
    """In words, which outputs in a machine's folder an earlier run made; '' where there are none.

    A machine that fails keeps them: whoever reads its folder alone would take its old table for today's.
    """
    from errpipe.pipeline.lock import read_lock

    try:
        earlier = [name for name in read_lock(folder) if name not in brought_up_to_date and (folder / name).is_dir()]
    except (ErrpipeError, OSError):
        return ""
    return f"; {MACHINES}/{folder.name} holds what an earlier run made: {', '.join(earlier)}" if earlier else ""


def _reset_peak() -> None:
    """Let the peak of this process' memory count from now, where the system can (Linux)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def _peak_mb() -> float:
    """Peak of resident memory, MB; 0 where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), 0.0)


def _failed_result(task: Sequence[Any], attempts: int) -> dict[str, Any]:
    message = f"its worker was killed {attempts} times (out of memory?)"
    message += _of_earlier(Path(task[3]) / MACHINES / task[1], ())
    nothing = {"responses": {}, "drift": [], "model": "", "seconds": 0.0, "peak_mb": 0.0}
    return nothing | {"name": task[1], "state": "failed", "message": message, "attempts": attempts}


Task = tuple[str, str, list[str], str]


def _in_processes(tasks: Sequence[Task], jobs: int) -> Iterator[dict[str, Any]]:
    """Results as they come. When a worker dies the pool is made anew and its unfinished machines are tried again."""
    attempts = dict.fromkeys((task[1] for task in tasks), 0)
    waiting = list(tasks)
    count = jobs or os.cpu_count() or 1
    while waiting:
        last_attempts = [t for t in waiting if attempts[t[1]] >= ATTEMPTS - 1]
        batch = last_attempts[:1] or waiting
        ended: set[str] = set()
        for task, result in _one_pool(batch, min(count, len(batch)), attempts):
            ended.add(task[1])
            yield result
        for task in batch:
            if task[1] not in ended and attempts[task[1]] >= ATTEMPTS:
                ended.add(task[1])
                yield _failed_result(task, attempts[task[1]])
        waiting = [t for t in waiting if t[1] not in ended]


def _one_pool(tasks: Sequence[Task], count: int, attempts: dict[str, int]) -> Iterator[tuple[Task, dict[str, Any]]]:
    """Results of one pool of processes until it is through or one of its workers dies; `attempts` is counted up."""
    with ProcessPoolExecutor(count, _start_imports(), _prepare, (dict(os.environ),)) as pool:
        waiting = list(reversed(tasks))
        running: dict[Future[dict[str, Any]], Task] = {}
        try:
            while waiting or running:
                while waiting and len(running) <= count:  # one lies ready; more would be lost with a worker
                    task = waiting.pop()
                    running[pool.submit(run_machine, *task)] = task
                    attempts[task[1]] += 1
                future = next(as_completed(running))
                result = future.result()
                task = running.pop(future)
                yield task, result | {"attempts": attempts[task[1]]}
        except BrokenProcessPool:
            return


def _start_imports() -> Any:
    """How workers are made: copies of a process that has imported what they need, and that begins to do so here.

    Where the system cannot copy a process, each worker imports for itself.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", WORKER])
    try:
        forkserver.ensure_running()
    except ChildProcessError:  # a copy of a process that has one: it is not the copy's to ask
        return multiprocessing.get_context("spawn")
    return context


def _prepare(environment: dict[str, str]) -> None:
    """Before a worker's first machine: the caller's environment, which may be another than the fork server's."""
    os.environ.update(environment)
    importlib.import_module(WORKER)


def _on_cluster(tasks: Sequence[Task], address: str) -> Iterator[dict[str, Any]]:
    """The same through a running Dask cluster, which itself tries again what a dead worker held."""
    try:
        from distributed import Client
        from distributed import as_completed as finished
    except ImportError:
        raise UsageError("--scheduler needs Dask: pip install 'errpipe[dask]'") from None
    try:
        client = Client(address, timeout=20, set_as_default=False)
    except (OSError, ValueError) as err:
        raise UsageError(f"--scheduler {address}: no Dask scheduler answers ({err})") from None
    with client:
        futures = {client.submit(run_machine, *task, pure=False, retries=ATTEMPTS - 1): task for task in tasks}
        for future in finished(list(futures), loop=client.loop):
            task = futures[future]
            yield future.result() if future.status == "finished" else _failed_result(task, ATTEMPTS)
