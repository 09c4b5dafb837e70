"""`errpipe init`: a working folder that runs at once, from a template, with a recording of its own or the user's."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.files import MOST_NEIGHBOURS, missing

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

PIPELINE = "pipeline.yaml"


@dataclass(frozen=True)
class Template:
    """sample: function of `simulation.sample_recordings` that makes the recording; None: the pipeline simulates it.

    own: the pipeline for a recording of the user's, where it is another one; needs: roles of which that has a column,
    at least of one; errors: components that it has all. The targets stand in the pipeline.
    """

    sample: str | None
    machine: str | None = None
    own: str | None = None
    needs: tuple[str, ...] = ()
    errors: tuple[str, ...] = ()


POSITIONING = ("positioning", "angular positioning")  # kinds of components of which ISO 230-2 has figures
HEAT = ("temperature", "spindle_speed")
EACH, END, SEVERAL = "@EACH@", "@END@", "  # @SEVERAL@"  # lines of a template that are repeated for every component

TEMPLATES = {
    "laser-iso230": Template("laser"),
    "dial-gauge": Template("dial_gauge"),
    "diagnose-log": Template("axis_log"),
    "spindle-drift": Template(None, own="spindle-drift-own", needs=HEAT),
    "gantry": Template("gantry", needs=("temperature",)),
    "drilled-plate": Template("drilled_plate", errors=("E_X", "E_Y")),
    "five-axis": Template(None, "five-axis.machine.yaml"),
}


def init(folder: Path, name: str, recording: Path | None = None, targets: Sequence[str] = ()) -> dict[str, Any]:
    """Write the template's files into a folder. Raises UsageError if one is there already.

    recording: a recording folder of the user's own, for which the pipeline is written; targets: instead of the usual.
    """
    from errpipe import jsonfile, yamlfile

    if name not in TEMPLATES:
        raise UsageError(f"no template {name!r} (templates: {', '.join(TEMPLATES)}).{did_you_mean(name, TEMPLATES)}")
    template, folder = TEMPLATES[name], Path(folder)
    if recording is not None and template.sample is None and template.own is None:
        raise UsageError(f"template {name} simulates its recording; replace that stage in {PIPELINE} (no --recording)")
    held = islice(folder.iterdir(), MOST_NEIGHBOURS) if folder.is_dir() and recording is None else ()
    if folder.is_file() or any(file.suffix.lower() in yamlfile.MEASURED for file in held):
        raise UsageError(
            f"{folder}: {'is a file' if folder.is_file() else 'holds measurements'} (DIR is the folder to write). "
            f"Measurements become a recording first: errpipe import {folder} --out recording --yes, then errpipe init "
            f"{folder.stem if folder.is_file() else 'axis'} --recording recording"
        )
    if not folder.exists() and folder.suffix.lower() in yamlfile.MEASURED:
        raise UsageError(f"{folder}: {missing(folder)} (DIR is the folder to write; its name ends like that of a file)")
    texts, why = _texts(name, template, folder, recording, targets)
    existing = [n for n in texts if (folder / n).exists()]
    if existing:
        raise UsageError(f"{folder}: {', '.join(existing)} already there; nothing was written (choose another folder)")
    if recording is None and template.sample is not None:
        from errpipe.domain.manifest_text import marked
        from errpipe.simulation import folder as recording_folder
        from errpipe.simulation import sample_recordings

        own = folder / "recording"
        recording_folder.write(own, getattr(sample_recordings, template.sample)())
        manifest, table = ((own / name).read_text("utf-8") for name in ("recording.yaml", "recording.csv"))
        jsonfile.write_text(own / "recording.yaml", marked(manifest, table))  # `import` may replace it
    for file, text in texts.items():
        jsonfile.write_text(folder / file, text)
    lines = [*(f"{folder / file}" for file in texts), *why]
    return {
        "template": name,
        "files": sorted(texts),
        "says": [*lines, f"next    errpipe run {folder / PIPELINE} --out {folder / 'out'}"],
    }


def _texts(
    name: str, template: Template, folder: Path, recording: Path | None, targets: Sequence[str]
) -> tuple[dict[str, str], list[str]]:
    """File -> text, and what else there is to say."""
    from errpipe import jsonfile
    from errpipe.pipeline.schema import json_schema
    from errpipe.pipeline.spec import pipeline_model
    from errpipe.stages import STAGES

    pattern = _data(f"{(template.own if recording else None) or name}.txt")
    pipeline, why = _filled(name, pattern, folder, recording, targets)
    texts = {
        PIPELINE: pipeline,
        "Makefile": _data("Makefile.txt"),
        ".gitignore": _data("gitignore.txt"),
        ".github/workflows/errpipe.yml": _data("workflow.txt"),
        "pipeline.schema.json": jsonfile.dumps(
            json_schema(pipeline_model(STAGES), "errpipe pipeline, version 1", written=True)
        ),
    }
    if template.machine is not None:
        texts["machine.yaml"] = _data(template.machine)
    return texts, why


def _data(file: str) -> str:
    return (resources.files("errpipe.stages") / "templates" / file).read_text(encoding="utf-8")


def _filled(
    name: str, text: str, folder: Path, recording: Path | None, targets: Sequence[str]
) -> tuple[str, list[str]]:
    """The pipeline with the recording's own axis, component and numbers in place of the @WORDS@; why its terms."""
    from errpipe.domain.manifest_text import scalar
    from errpipe.stages.targets import chosen
    from errpipe.verbs import _init_curve, _init_heat

    words = {"AXIS": "X", "COMPONENT": "EXX", "RECORDING": "recording", "DEGREE": "10", "ISO": "true"}
    words["HOLDOUT"] = "{scheme: leave-one-run-out}"
    backlash, sensors = True, ["frame_t", "bed_t"]
    if name == "gantry":
        words["COMPONENT"] = "E_Z"
    drifts = []
    if recording is not None:
        facts = _facts(Path(recording))
        words |= facts["words"]
        backlash, sensors = facts["both_directions"], facts["sensors"]
        needs = TEMPLATES[name].needs
        if needs and not {*needs} & facts["roles"]:
            raise UsageError(f"{recording}: no column of role {' or '.join(needs)}, which template {name} needs")
        absent = [c for c in TEMPLATES[name].errors if c not in facts["components"]]
        if absent:
            have = ", ".join(facts["components"])
            raise UsageError(f"{recording}: no error of {absent[0]}, which template {name} needs (it has: {have})")
        if facts["others"] and EACH not in text:
            also = f"  # recorded too: {', '.join(facts['others'])}"
            text = re.sub(r"(?m)^( +(?:- )?component: @COMPONENT@)$", rf"\g<1>{also}", text)
        words["RECORDING"] = json.dumps(Path(os.path.relpath(recording, folder)).as_posix(), ensure_ascii=False)
        drifts = facts["drifts"]
    drifts = drifts or [words["COMPONENT"]]
    text, words["COMPONENTS"] = _for_each(text, drifts), ", ".join(drifts)
    words["METHOD"] = "ridge" if recording is not None and len(sensors) > 1 else "linear"
    text = re.sub(
        r"(?m)^.*@SENSOR@.*\n", lambda line: "".join(line[0].replace("@SENSOR@", scalar(s)) for s in sensors), text
    )
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    kept = [line for line in text.splitlines() if backlash or "term: backlash" not in line]
    own = facts["recording"] if recording is not None else None
    text, of_curve = _init_curve.proposed("\n".join([*kept, ""]), own)
    text, of_heat = _init_heat.proposed(text, own)
    why = [*of_curve, *of_heat]
    if targets:
        chosen(targets)
        text = re.sub(r"(?m)^(\s*targets: ).*", rf"\g<1>[{', '.join(targets)}]", text)
    return text, why


def _for_each(text: str, components: Sequence[str]) -> str:
    """The lines from EACH to END once for every component; those marked SEVERAL only if there are several."""
    if EACH not in text:
        return text
    before, rest = text.split(f"{EACH}\n")
    block, after = rest.split(f"{END}\n")
    named = [line for line in block.splitlines(keepends=True) if len(components) > 1 or SEVERAL not in line]
    once = "".join(named).replace(SEVERAL, "")
    return before + "".join(once.replace("@COMPONENT@", name) for name in components) + after


def _facts(folder: Path) -> dict[str, Any]:
    """What the recording states: axis, component, numbers of targets and runs, whether both directions are, sensors."""
    import numpy as np

    from errpipe.domain import components
    from errpipe.formats import manifest_folder
    from errpipe.validation import iso230_2

    recording = manifest_folder.read(folder)
    recorded = recording.components()
    if not recorded:
        raise UsageError(f"{folder}: no column of role error; there is nothing to fit")
    component = next((c for c in recorded if components.parse(c).kind in POSITIONING), _widest(recording))
    places = [c.axis for c in recording.manifest.columns.values() if c.role in ("command", "position") and c.axis]
    axis = components.parse(component).axis or next(iter(places), "X")
    place = recording.name("command", axis=axis) or recording.name("position", axis=axis)
    targets = np.unique(np.round(recording.array(place), 3)).size if place is not None else 3
    side = recording.name("direction", axis=axis)
    both = side is not None and np.unique(recording.array(side)).size > 1
    runs, roles = len(recording.run_labels()), {c.role for c in recording.manifest.columns.values()}
    words = {"AXIS": axis, "COMPONENT": component, "DEGREE": str(max(1, min(10, targets // 2)))}
    words["HOLDOUT"] = "{scheme: leave-one-run-out}" if runs > 1 else "{scheme: blocks, blocks: 5}"
    words["ISO"] = "false"
    if both and components.parse(component).kind in POSITIONING:
        with suppress(DataError):  # a target that was visited once from a side
            iso230_2.figures(recording, component=component)
            words["ISO"] = "true"
    return {
        "words": words,
        "both_directions": both,
        "sensors": recording.names("temperature"),
        "roles": roles,
        "components": recorded,
        "others": [c for c in recorded if c != component],
        "drifts": [c for c in (component, *(c for c in recorded if c != component)) if _drifts(recording, c)],
        "recording": recording if place is not None and recording.manifest.columns[place].unit == "mm" else None,
    }


def _drifts(recording: Recording, component: str) -> bool:
    """Whether a component is a deviation (a force does not follow heat) that changes within the recording."""
    import numpy as np

    from errpipe.domain.components import is_force

    values = recording.array(str(recording.name("error", component=component)))
    known = values[np.isfinite(values)]
    return not is_force(component) and known.size > 1 and bool(np.ptp(known) > 0)


def _widest(recording: Recording) -> str:
    """The component with the largest standard deviation, among those with the unit of the first."""
    import numpy as np

    columns = {c: str(recording.name("error", component=c)) for c in recording.components()}
    unit = {c: recording.manifest.columns[name].unit for c, name in columns.items()}
    first = next(iter(columns))
    same_unit = [c for c in columns if unit[c] == unit[first]]
    return max(same_unit, key=lambda c: float(np.nan_to_num(np.nanstd(recording.array(columns[c])))))
