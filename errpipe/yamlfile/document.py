"""A YAML text as plain values, each with its place in the file, and its validation."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from errpipe import files
from errpipe.errors import ConfigError, Problem, UsageError
from errpipe.yamlfile.events import Builder
from errpipe.yamlfile.explain import explain
from errpipe.yamlfile.places import Location, Place, describe, dotted
from errpipe.yamlfile.quantities import convert_quantities

T = TypeVar("T")

MEASURED = (".csv", ".tsv", ".xlsx", ".xls", ".h5", ".hdf5", ".mat", ".tdms", ".parquet", ".feather", ".zip", ".gz")
MAX_BYTES = 4_000_000  # a configuration is written by hand
MOST_NAMED = 3  # files of a folder in a message


@dataclass
class Document:
    """The plain values of a YAML text (dict, list, str, int, float, bool, None) and where each of them stands."""

    file: str
    value: Any = None
    locations: dict[Place, Location] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def problem(self, place: Place, message: str, *, at: str = "value") -> Problem:
        """A problem at a place; `at` is "value", "key", or "parent" for what is missing there."""
        where = place[:-1] if at == "parent" else place
        while where and where not in self.locations:
            where = where[:-1]
        spot = self.locations.get(where, Location((1, 1)))
        if spot.origin is not None:
            return Problem(spot.origin, 0, 0, dotted(place), message)
        line, column = spot.key if at != "value" and spot.key else spot.value
        return Problem(self.file, line, column, dotted(place), message)

    def raise_problems(self) -> None:
        """Raises ConfigError if there is any problem so far."""
        if self.problems:
            raise ConfigError(list(dict.fromkeys(self.problems)))

    def validate(self, model: type[T] | Any) -> T:
        """The value as an instance of a pydantic model. Raises ConfigError with every problem of the file."""
        validated = self.check(model)
        self.raise_problems()
        return validated  # type: ignore[return-value]

    def check(self, model: type[T] | Any, context: Mapping[str, Any] | None = None) -> T | None:
        """Like `validate`, but problems are only collected in `problems`; None where there are any."""
        # JSON in strict mode is exactly what is wanted: lists become tuples and texts become paths,
        # but '5' is no number, 1 is no text and 'no' is not false.
        value, wrong = convert_quantities(model, self.value)
        self.problems.extend(self.problem(place, message) for place, message in wrong)
        places = {place for place, _ in wrong}
        try:
            validated = TypeAdapter(model).validate_json(json.dumps(value), strict=True, context=dict(context or {}))
            return None if wrong else validated
        except ValidationError as err:
            explained = explain(self.problem, value, model, err.errors(include_url=False))
            reported = {(problem.line, problem.column) for problem in self.problems if problem.line}
            self.problems.extend(
                one for place, one in explained if place not in places and (one.line, one.column) not in reported
            )
            return None

    def assign(self, place: Place, value: Any, origin: str) -> None:
        """Put a value at a place (`--set`). Raises UsageError if the place cannot hold one."""
        target = self.value
        for depth, step in enumerate(place):
            here = dotted(place[:depth]) or "the file"
            if isinstance(target, list):
                if not isinstance(step, int) or not 0 <= step < len(target):
                    raise UsageError(f"{origin}: {here} is a list of {len(target)}; {step!r} is not one of its indices")
            elif not isinstance(target, dict):
                raise UsageError(f"{origin}: {here} is {describe(target)}, not a mapping")
            else:
                step = str(step)
            if depth == len(place) - 1:
                target[step] = value
            else:
                target = target.setdefault(step, {}) if isinstance(target, dict) else target[step]
        for old in [spot for spot in self.locations if spot[: len(place)] == place]:
            del self.locations[old]
        self.locations[place] = Location(origin=origin)


def load(path: Path, model: type[T] | Any, *, environment: Mapping[str, str] | None = None) -> T:
    """Read and validate a YAML file. Raises ConfigError with every problem of the file, in file order."""
    return read(path, environment=environment).validate(model)


def read(path: Path, *, environment: Mapping[str, str] | None = None) -> Document:
    """Read a YAML file. Raises ConfigError if it cannot be read or parsed; lesser problems stay in `problems`.

    With an `environment`, `${NAME}` and `${NAME:-default}` in texts are replaced.
    """
    return parse(text_of(path), str(path), environment=environment)


def _inside(folder: Path) -> str:
    """`: pipeline.yaml`, the first YAML files of a folder; else how its measurements are read."""
    held = sorted(islice((p for p in folder.iterdir() if p.is_file()), files.MOST_NEIGHBOURS))
    yaml = [str(p) for p in held if p.suffix in (".yaml", ".yml") and p.name != "recording.yaml"]
    yaml = [name for name in yaml if Path(name).name == "pipeline.yaml"] or yaml
    if yaml or not any(p.suffix.lower() in MEASURED for p in held):
        return f": {', '.join(yaml[:MOST_NAMED])}" if yaml else ""
    return f"; measurements are read by errpipe import {folder} --out recording"


def text_of(path: Path) -> str:
    """The text of a YAML file. Raises ConfigError if it cannot be read."""
    path, name = Path(path), str(path)
    if path.is_dir():
        raise ConfigError([Problem(name, 0, 0, "", f"is a folder (a YAML file is needed{_inside(path)})")])
    if path.is_file() and path.suffix.lower() in MEASURED:
        needed = f"a YAML file is needed; measurements are read by errpipe import {name} --out recording"
        raise ConfigError([Problem(name, 0, 0, "", f"is a file of measurements by its name ({needed})")])
    try:
        with files.open_regular(path) as stream:
            data, size = stream.read(MAX_BYTES + 1), os.fstat(stream.fileno()).st_size
    except FileNotFoundError:
        raise ConfigError([Problem(name, 0, 0, "", files.missing(path))]) from None
    except OSError as err:
        raise ConfigError([Problem(name, 0, 0, "", files.why(err))]) from None
    if len(data) > MAX_BYTES:
        raise ConfigError([Problem(name, 0, 0, "", f"has {size} bytes (at most {MAX_BYTES} are read)")])
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        line = data.count(b"\n", 0, err.start) + 1
        column = err.start - data.rfind(b"\n", 0, err.start)
        raise ConfigError([Problem(name, line, column, "", f"not UTF-8 text (byte 0x{data[err.start]:02x})")]) from None


def parse(text: str, file: str = "text", *, environment: Mapping[str, str] | None = None) -> Document:
    """`read` for a text that is at hand."""
    builder = Builder(file, environment)
    value = builder.build(text)
    return Document(file, value, builder.locations, builder.problems)
