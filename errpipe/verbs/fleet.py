"""`errpipe fleet`: one pipeline for many machines, in processes of their own or on a Dask cluster; one report.

Workers get paths and return a few numbers; the output of a machine's run is in OUT/machines/NAME. A machine
that fails, or whose worker dies, does not stop the others. What was finished is not run again.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from errpipe import jsonfile, yamlfile
from errpipe.errors import ErrpipeError, UsageError, did_you_mean
from errpipe.verbs import fleet_processes
from errpipe.verbs.fleet_processes import ATTEMPTS, MACHINES, Task
from errpipe.yamlfile import Options

if TYPE_CHECKING:
    from errpipe.pipeline.spec import Pipeline

TIMES = "times.csv"
CONNECTS = 5  # s in which a scheduler answers
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
    one_machine: bool = Field(
        False, description="The recordings are parts of one machine's history, each of whole runs: one fit to all."
    )

    @model_validator(mode="after")
    def _some(self) -> Fleet:
        if self.recordings is None and not self.machines:
            raise ValueError("`recordings` or `machines` is needed")
        if self.pool and self.one_machine:
            raise ValueError("`pool` needs several machines, and `one_machine` is one")
        names = [m.name.lower() for m in self.machines]
        if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
            raise ValueError(f"two machines have one name: {', '.join(twice)} (small and capital letters are one)")
        return self


def fleet(
    file: Path, out: Path, jobs: int = 0, scheduler: str | None = None, progress: Progress = lambda share, text: None
) -> dict[str, Any]:
    """Run every machine, then write the report. Returns its document with times and memory.

    jobs: processes, 0 for one per core; scheduler: address of a running Dask cluster instead. Raises ConfigError,
    UsageError; the failure of one machine is recorded in the document.
    """
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES

    spec: Fleet = yamlfile.load(Path(file), Fleet)
    root = Path(file).parent.absolute()
    pipeline = root / spec.pipeline
    tasks = [(str(pipeline), m.name, list(m.set), str(Path(out).absolute())) for m in machines_of(spec, root)]
    if spec.recordings is not None and Path(out).resolve().is_relative_to((root / spec.recordings).resolve()):
        raise UsageError(f"{out}: inside {spec.recordings}, where it would be read as a machine")
    if spec.recordings is not None:
        _refuse_stage(Path(file), pipeline, spec.stage)
    _refuse_for_all(lambda sets: load_pipeline(pipeline, STAGES, sets=sets), [task[2] for task in tasks])
    if spec.one_machine:
        return _history(tasks, load_pipeline(pipeline, STAGES, sets=tasks[0][2]), jobs, scheduler, progress)
    types = {m.name: m.type for m in machines_of(spec, root)}
    results: dict[str, dict[str, Any]] = {}
    models: dict[str, Future[Any]] = {}

    def model_of(result: dict[str, Any]) -> Any:
        return report.result().model_of(result)

    def run(some: Sequence[Task]) -> None:
        for result in (
            _on_cluster(some, scheduler) if scheduler is not None else fleet_processes.in_processes(some, jobs)
        ):
            name = result["name"]
            results[name], models[name] = result, reader.submit(model_of, result)
            progress(len(results) / len(tasks), f"{name}: {result['state']}")

    with ThreadPoolExecutor(1) as reader:  # the report is imported, and models are checked, while machines run
        report = reader.submit(importlib.import_module, "errpipe.verbs._fleet_report")
        run(tasks if spec.recordings is None else _largest_first(tasks, root / spec.recordings))
        undetermined = [name for name, result in results.items() if result.get("undetermined")] if spec.pool else []
        if undetermined:
            own = {name: model.result() for name, model in models.items()}
            why = {name: results[name]["message"].partition(f"; {MACHINES}/")[0] for name in undetermined}
            from errpipe.verbs._fleet_types import tasks_with_priors

            run(again := tasks_with_priors(tasks, undetermined, results, own, types))
            for _, name, *_ in again:
                results[name]["borrows"] = results[name]["state"] != "failed"
                if results[name]["borrows"]:
                    results[name]["message"] = "; ".join(filter(None, (results[name]["message"], BORROWS + why[name])))
        read = {name: model.result() for name, model in models.items()}
    ordered = [results[task[1]] for task in tasks]
    document = report.result().write_report(spec.title, spec.pool, types, ordered, read, Path(out))
    rows = [f"{r['name']},{r['seconds']:.2f},{r['peak_mb']:.0f},{r['attempts']}" for r in ordered]
    jsonfile.write_text(Path(out) / TIMES, "\n".join(["machine,seconds,peak_mb,attempts", *rows, ""]))
    return document | {"times": {r["name"]: {k: r[k] for k in ("seconds", "peak_mb", "attempts")} for r in ordered}}


def _history(
    tasks: Sequence[Task], pipeline: Pipeline, jobs: int, scheduler: str | None, progress: Progress
) -> dict[str, Any]:
    """One fit to all recordings. Raises DataError with the name of the part that failed."""
    history = importlib.import_module("errpipe.verbs._fleet_history")
    _, stage = history.fitted_stages(pipeline)
    with _client(scheduler) if scheduler is not None else nullcontext() as client:
        passes = history.on_cluster(tasks, stage, client) if client else history.in_processes(tasks, stage, jobs)
        result: dict[str, Any] = history.fit_together(tasks, pipeline, passes, progress)
    return result


def _largest_first(tasks: Sequence[Task], recordings: Path) -> list[Task]:
    """Machines by the bytes of their recordings: begun last, the longest would keep one worker when others idle."""

    def size(task: Task) -> int:
        return sum(p.stat().st_size for p in (recordings / task[1]).iterdir() if p.is_file())

    return sorted(tasks, key=size, reverse=True)


def _refuse_stage(file: Path, pipeline: Path, name: str) -> None:
    """Raises UsageError where the pipeline has no stage of the name that is to read the recordings."""
    document = yamlfile.read(pipeline)
    stages = document.value.get("stages") if isinstance(document.value, dict) else None
    known = (
        [str(s.get("name") or s.get("kind")) for s in stages if isinstance(s, dict)] if isinstance(stages, list) else []
    )
    if known and name not in known:
        raise UsageError(
            f"{file}: `stage` names the stage of {pipeline.name} that reads a recording; found {name!r} (allowed:"
            f" {', '.join(known)}).{did_you_mean(name, known)}"
        )


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
    if invalid := [name for name in names if not re.fullmatch(NAME, name)]:
        raise UsageError(
            f"{folder}: no name of a machine: {', '.join(invalid)} (allowed: letters, digits, '.', '_' and '-')"
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


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """A client of a running Dask cluster. Raises UsageError without Dask, or where no scheduler answers."""
    try:
        import asyncio

        from distributed import Client
    except ImportError:
        raise UsageError("--scheduler needs Dask: pip install 'errpipe[dask]'") from None
    try:
        asyncio.run(_answer(address))
    except (OSError, ValueError, OverflowError) as err:
        raise UsageError(f"--scheduler {address}: no Dask scheduler answers ({err})") from None
    with Client(address, timeout=20, set_as_default=False) as client:
        yield client


def _on_cluster(tasks: Sequence[Task], address: str) -> Iterator[dict[str, Any]]:
    """The same through a running Dask cluster, which itself tries again what a dead worker held."""
    with _client(address) as client:
        from distributed import as_completed as finished

        futures = {
            client.submit(fleet_processes.run_machine, *task, pure=False, retries=ATTEMPTS - 1): task for task in tasks
        }
        for future in finished(list(futures), loop=client.loop):
            task = futures[future]
            yield future.result() if future.status == "finished" else fleet_processes.failed_result(task, ATTEMPTS)


async def _answer(address: str) -> None:
    """Raises OSError or ValueError where no scheduler answers; a client that gives up keeps the process a minute."""
    from distributed.core import connect
    from distributed.security import Security

    comm = await connect(address, timeout=CONNECTS, **Security().get_connection_args("client"))
    comm.abort()
