"""What a stage is to the engine: parameters, what it reads, what it writes, and one function.

A stage is one pydantic class with a `kind`. The engine uses nothing else of it:

    class Fit(Stage):
        \"\"\"Fit terms to the cleaned recording.\"\"\"

        kind: Literal["fit"]
        alpha: float = Field(1.0, gt=0, json_schema_extra={"unit": "um"}, description="...")
        code_version = 2
        takes = {"recording": Need("recording")}
        gives = ("error_model",)
        writes = ("error_model.json",)

        def run(self, context):
            folder = context.needed("recording")            # of the nearest earlier stage that gives a recording
            context.progress(0.5, "half way")
            context.write_json("error_model.json", {...})   # or any writer, into context.folder
            return {"held_out_rms_um": 1.3}                 # a few numbers for the terminal

Everything a stage writes into `context.folder` (a scratch folder) is published whole when `run` returns:
files whose bytes did not change are not touched, files it no longer writes disappear. A stage must
not write anything with a clock, a host name or a path in it: equal inputs give equal bytes.

Stages are linked by the types of what they take and give, never by another stage's name or kind: a new stage that
takes a recording and gives one stands between any two others.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from errpipe import jsonfile
from errpipe.errors import DataError
from errpipe.files import inside
from errpipe.yamlfile import Options


def _named(path: object) -> object:
    if path == "":
        raise ValueError("is empty (the name of a file or folder is needed)")
    return path


def _from_root(path: Path, info: ValidationInfo) -> Path:
    """A relative path starts at the pipeline's root folder, which the loader hands over as context."""
    root = (info.context or {}).get("root")
    return path if root is None else Path(os.path.normpath(Path(root) / path))


# A file or folder outside OUT. Relative to the pipeline's `root`; only its last part enters the lock file,
# so that moving the data (or another machine) changes nothing.
InputPath = Annotated[Path, BeforeValidator(_named), AfterValidator(_from_root)]


@dataclass(frozen=True)
class Need:
    """An artefact of a type, from the nearest earlier stage that gives one; with `every`, from all of them.

    `every` leaves out what an earlier stage already turned into another artefact of that type (a recording that was
    cleaned). Where `optional`, a pipeline without such a stage is fine and the stage is given nothing. `unless` names
    another slot of the stage that may be met instead, `only_with` one without which this slot is not read.
    """

    type: str
    optional: bool = False
    every: bool = False
    unless: str = ""
    only_with: str = ""


@dataclass(frozen=True)
class Context:
    """Argument of `Stage.run`.

    folder: write here. fingerprint: SHA-256 of parameters and input contents, for artefacts to carry.
    stages: folders of the needed stages, slot -> stage name -> folder. title: the pipeline's.
    """

    folder: Path
    fingerprint: str = ""
    title: str = ""
    stages: Mapping[str, Mapping[str, Path]] = field(default_factory=dict)
    progress: Callable[[float, str], None] = lambda fraction, text: None

    def needed(self, slot: str) -> Path:
        """The folder of the one stage of a slot. Raises KeyError if an optional one is absent."""
        (folder,) = self.stages[slot].values() if self.stages.get(slot) else (None,)
        if folder is None:
            raise KeyError(slot)
        return folder

    def optional(self, slot: str) -> Path | None:
        """The folder of the one stage of a slot, or None."""
        return next(iter(self.stages.get(slot, {}).values()), None)

    def every(self, slot: str) -> Mapping[str, Path]:
        """Stage name -> folder of every stage of a slot, in file order."""
        return self.stages.get(slot, {})

    def write_json(self, name: str, value: Any) -> Path:
        """Write canonical JSON into the stage's folder."""
        jsonfile.write(self._place(name), value)
        return self.folder / name

    def write_text(self, name: str, text: str) -> Path:
        """Write UTF-8 text into the stage's folder."""
        jsonfile.write_text(self._place(name), text)
        return self.folder / name

    def write_bytes(self, name: str, data: bytes) -> Path:
        """Write bytes into the stage's folder."""
        jsonfile.write_bytes(self._place(name), data)
        return self.folder / name

    def _place(self, name: str) -> Path:
        return inside(self.folder, name, DataError)


class Stage(Options, ABC):
    """Base of every stage. Subclasses give `kind` as a Literal and their options as fields."""

    kind: str
    name: str | None = Field(
        None, pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", description="Name of the stage and of its folder; default: its kind."
    )
    source: dict[str, str | tuple[str, ...]] = Field(
        {},
        alias="from",
        description="Which earlier stages to read, slot: stage name; default: the nearest that gives it.",
    )

    writes: ClassVar[tuple[str, ...]] = ()
    code_version: ClassVar[int] = 1  # raise it when the same inputs give other outputs
    takes: ClassVar[Mapping[str, Need]] = {}  # slot -> the artefact it needs of an earlier stage
    gives: ClassVar[tuple[str, ...]] = ()  # types of the artefacts in its folder
    file_types: ClassVar[Mapping[str, str]] = {}  # file -> type: who takes no such artefact does not read it
    variant_key: ClassVar[str] = ""  # discriminating key of several classes of one kind
    default_variant: ClassVar[str] = ""  # its value where it is not written

    @property
    def label(self) -> str:
        """The stage's name: its folder inside OUT."""
        return self.name or self.kind

    def inputs(self) -> Sequence[Path]:
        """External files and folders it reads (a folder stands for all files below it, hidden ones not)."""
        parts = [value if isinstance(value, tuple) else (value,) for _, value in self]
        return [part for group in parts for part in group if isinstance(part, Path)]

    def outputs(self) -> Sequence[str]:
        """Files it promises to write into its folder (`writes`, unless an option changes them); it may write more."""
        return self.writes

    def parameters(self) -> dict[str, Any]:
        """Canonical parameters for the lock file: JSON values, and of a path only its last part."""
        return {key: _canonical(value) for key, value in self if key not in ("kind", "name", "source")}

    @abstractmethod
    def run(self, context: Context) -> Mapping[str, Any]:
        """Do the work. Returns a few summary numbers or texts (JSON values). Raises ErrpipeError."""


def _canonical(value: Any) -> Any:
    """JSON value of a parameter; models become mappings, paths their last part."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Options):
        return {key: _canonical(part) for key, part in value}
    if isinstance(value, Mapping):
        return {str(key): _canonical(part) for key, part in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        parts = [_canonical(part) for part in value]
        return sorted(parts, key=jsonfile.dumps) if isinstance(value, set | frozenset) else parts
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    return value
