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
from typing import TYPE_CHECKING

from errpipe import jsonfile
from errpipe.errors import UsageError
from errpipe.pipeline.lock import label_inputs

if TYPE_CHECKING:
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
    names = [os.fspath(path) for path in inputs]
    text = " \\\n  ".join([f"{_escape(target, target=True)} :", *(_escape(name) for name in names)]) + "\n"
    text += "".join(f"\n{_escape(name, target=True)} :\n" for name in names)
    return (f"{_EQUALS} := =\n" if f"$({_EQUALS})" in text else "") + text


def _escape(name: str, *, target: bool = False) -> str:
    """A file name as GNU make reads it. `|` ends the names of a rule, `%` makes a target a pattern."""
    if re.search(r"[\r\n;]|\\$|.\(.*\)$", name):
        raise UsageError(f"{name!r}: make cannot read such a name (a line break, ';', '\\' or '(...)' at its end)")
    name = f"./{name}" if name.startswith("~") else name
    special = r"[ \t#:?*\[\]%]" if target else r"[ \t#:?*\[\]|]"
    # backslashes count only before a character that make would otherwise take as its own
    name = re.sub(rf"(\\*)({special})", lambda m: m[1] * 2 + "\\" + m[2], name.replace("$", "$$"))
    return name.replace("=", f"$({_EQUALS})")


def touch(stamp: Path, begun: int) -> None:
    """Give the stamp the time when the run began, ns, also if nothing ran: an input that changed since is newer."""
    if not stamp.exists():
        jsonfile.write_text(stamp, "")
    os.utime(stamp, ns=(begun, begun))
