"""A dependency file for make: which inputs a stamp depends on, so that make knows when to call errpipe.

    out/run.stamp: pipelines/thermal.yaml
    	errpipe run pipelines/thermal.yaml --out out --depfile out/run.d --stamp out/run.stamp
    -include out/run.d

Every input also gets a rule of its own without a recipe (as `gcc -MP` writes), so that a deleted log does
not stop make. Names are escaped the way GNU make 4 reads them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from errpipe import jsonfile
from errpipe.errors import UsageError
from errpipe.pipeline.lock import label_inputs
from errpipe.pipeline.spec import Pipeline
from errpipe.pipeline.stage import Stage

_EQUALS = "errpipe_equals"  # make has no escape for `=` on a line of its own: a variable stands in


def inputs_of(pipeline: Pipeline, stages: Iterable[Stage]) -> list[Path]:
    """The pipeline file and every external file that the stages read, sorted, each once."""
    files = {pipeline.file}
    for stage in stages:
        files.update(label_inputs(stage.inputs()).values())
    return sorted(files)


def depfile(target: str, inputs: Iterable[Path]) -> str:
    """The text of a dependency file. Raises UsageError for a name that make cannot read."""
    names = [escape(os.fspath(path)) for path in inputs]
    head = f"{_EQUALS} := =\n" if any(f"$({_EQUALS})" in name for name in [escape(target), *names]) else ""
    rule = " \\\n  ".join([f"{escape(target)}:", *names])
    return head + rule + "\n" + "".join(f"\n{name}:\n" for name in names)


def escape(name: str) -> str:
    """A file name as make reads it in a target or a prerequisite. Raises UsageError for a line break."""
    if "\n" in name or "\r" in name:
        raise UsageError(f"{name!r}: make cannot read a file name with a line break in it")
    # backslashes count only where they stand before a character that make would otherwise take as its own
    name = re.sub(r"(\\*)([ \t#:;%|&?*\[\]])", lambda m: m[1] * 2 + "\\" + m[2], name.replace("$", "$$"))
    name = re.sub(r"(\\+)$", lambda m: m[1] * 2, name)
    return name.replace("=", f"$({_EQUALS})").replace("~", "\\~") if name.startswith("~") else name.replace(
        "=", f"$({_EQUALS})"
    )


def touch(stamp: Path) -> None:
    """Touch the stamp, always: make asks again forever where a run that found nothing to do left it old."""
    if not stamp.exists():
        jsonfile.write_text(stamp, "")
    os.utime(stamp)
