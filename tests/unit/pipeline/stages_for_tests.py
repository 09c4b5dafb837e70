"""Three cheap stages that know no physics, and a pipeline that links them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from errpipe.errors import DataError
from errpipe.pipeline.stage import Context, InputPath, Need, Stage


class Take(Stage):
    """Copy the lines of its inputs."""

    kind: Literal["take"]
    files: InputPath = Field(description="A file or a folder.")
    gives: ClassVar[tuple[str, ...]] = ("lines",)

    def outputs(self) -> Sequence[str]:
        return ("lines.txt",)

    def run(self, context: Context) -> Mapping[str, Any]:
        paths = [self.files] if self.files.is_file() else sorted(self.files.rglob("*.txt"))
        text = "".join(path.read_text() for path in paths)
        context.write_text("lines.txt", text)
        return {"lines": text.count("\n")}


class Scale(Stage):
    """Multiply every line by a factor; one file per `parts`, slowly if asked."""

    kind: Literal["scale"]
    factor: float = Field(1.0, gt=0, json_schema_extra={"unit": "um"}, description="Factor.")
    parts: int = Field(1, ge=0, json_schema_extra={"unit": "1"}, description="Number of files.")
    pause: float = Field(0.0, ge=0, json_schema_extra={"unit": "s"}, description="Wait before every file.")
    fails: bool = Field(False, description="Fail after the first file.")
    takes: ClassVar[Mapping[str, Need]] = {"lines": Need("lines")}
    gives: ClassVar[tuple[str, ...]] = ("parts",)

    def run(self, context: Context) -> Mapping[str, Any]:
        numbers = [float(line) for line in (context.needed("lines") / "lines.txt").read_text().split()]
        for part in range(self.parts):
            time.sleep(self.pause)
            context.progress((part + 1) / self.parts, f"part {part + 1}")
            context.write_json(f"parts/{part}.json", [number * self.factor + part for number in numbers])
            if self.fails:
                raise DataError("told to fail")
        return {"numbers": len(numbers)}


class Sum(Stage):
    """Add up what every scale stage wrote."""

    kind: Literal["sum"]
    takes: ClassVar[Mapping[str, Need]] = {
        "parts": Need("parts", every=True),
        "lines": Need("lines", optional=True),
        "other": Need("sum", optional=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("sum",)

    def outputs(self) -> Sequence[str]:
        return ("sum.json",)

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe import jsonfile

        total = {
            name: sum(sum(jsonfile.read(path)) for path in sorted(folder.rglob("*.json")))
            for name, folder in context.every("parts").items()
        }
        context.write_json("sum.json", {"total": total, "fingerprint": context.fingerprint, "title": context.title})
        return {"total": sum(total.values()), "had_lines": context.optional("lines") is not None}


STAGES = (Take, Scale, Sum)

TEXT = """\
pipeline: 1
title: three stages
stages:
  - {kind: take, files: data}
  - {kind: scale, factor: 2}
  - {kind: scale, name: thirds, factor: 3, parts: 2}
  - {kind: sum}
"""


def write_stages(folder: Path, text: str = TEXT) -> Path:
    """Data and a pipeline file in a folder; the pipeline file."""
    (folder / "data").mkdir(parents=True, exist_ok=True)
    (folder / "data" / "a.txt").write_text("1\n2\n")
    (folder / "data" / "b.txt").write_text("3\n")
    (folder / "p.yaml").write_text(text)
    return folder / "p.yaml"


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too, with its bytes."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
