"""The reference pages, from the code alone: terms, formats, targets, stages, cleaning rules and recordings as Markdown.

Each registry is read once; a page gives the docstring, the parameters and the options of every plug-in.
`errpipe reference --write docs` writes all pages; a test holds the files in `docs/` to them.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

from errpipe import jsonfile
from errpipe.domain.protocols import PROTOCOLS
from errpipe.domain.recording import ROLE_UNITS, Column, Constant, Manifest
from errpipe.domain.units import FLOWING
from errpipe.errors import UsageError, did_you_mean
from errpipe.stages._docstrings import sections
from errpipe.terms import example_of

_LEFT_OUT = {"kind", "term", "rule", "family", "format"}  # the discriminators: they are the heading


def _cell(text: object) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")


def _table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> Iterator[str]:
    names = list(head)
    yield "| " + " | ".join(names) + " |"
    yield "| " + " | ".join("---" for _ in names) + " |"
    for row in rows:
        yield "| " + " | ".join(_cell(value) for value in row) + " |"


def _options(model: Any, without: frozenset[str] = frozenset()) -> Iterator[str]:
    """The options of a pydantic model: name, default, unit, meaning."""
    rows = []
    for name, field in model.model_fields.items():
        if name in _LEFT_OUT or name in without:
            continue
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        default = "required" if field.is_required() else _default(field)
        rows.append((f"`{field.alias or name}`", default, extra.get("unit", ""), field.description or ""))
    if rows:
        yield ""
        yield from _table(("option", "default", "unit", "meaning"), rows)


def _default(field: Any) -> str:
    value = field.get_default(call_default_factory=True)
    if value is None or value in ({}, (), ""):
        return "none"
    text = str(value)
    return f"`{text}`" if len(text) <= 40 and "=" not in text and "\n" not in text else "see text"


def _term(term: Any) -> Iterator[str]:
    about, parts = sections(term.__doc__)
    yield from (f"## `{term.model_fields['term'].default}`", "", about, "")
    for word, text in parts:
        if word == "Equation":
            yield "```\n" + text + "\n```"
        else:
            yield f"**{word}.** {_cell(text)}  "
    if term.reports_as:
        yield f"**Effect.** `{term.reports_as}`, of the family {term.family or 'none'}  "
    if not term.compensable:
        yield "**Compensation.** Never: the effect belongs to the measurement, not to the machine.  "
    bound = example_of(term).term
    rows = [
        (f"`{p.name}`", p.unit, f"{p.typical[0]:g} … {p.typical[1]:g}", f"{p.bounds[0]:g} … {p.bounds[1]:g}", p.meaning)
        for p in (*bound.linear(), *bound.nonlinear())
    ]
    if rows:
        yield from ("", "Parameters of its worked example:", "")
        yield from _table(("parameter", "unit", "typical", "bounds", "meaning"), rows)
    yield from _options(term, frozenset({"fixed"}))


def _format(module: Any) -> Iterator[str]:
    yield from (f"## `{module.name}`", "", inspect.cleandoc(module.__doc__))
    yield from _options(module.Options)


def _target(target: Any) -> Iterator[str]:
    yield from (f"## `{target.name}`", "", f"{target.controller}. {_cell(target.__doc__)}", "")
    yield from ("```\n" + inspect.cleandoc(inspect.getmodule(target).__doc__ or "") + "\n```", "")
    for fact in ("sign", "limits", "confidence", "source"):
        yield f"**{fact.capitalize()}.** {_cell(getattr(target, fact))}  "
    if target.goes_with:
        yield "**Combined with.** " + ", ".join(f"`{name}`" for name in target.goes_with) + "  "
    yield from ("", "At the machine:", "")
    yield from (f"{i}. {_cell(step)}" for i, step in enumerate(target.activation, 1))


def _stage(stage: Any) -> Iterator[str]:
    variant = stage.variant_key and f", `{stage.variant_key}: {stage.model_fields[stage.variant_key].default}`"
    heading = f"## `{stage.model_fields['kind'].annotation.__args__[0]}`{variant}"
    yield from (heading, "", inspect.cleandoc(stage.__doc__), "")
    takes = [
        f"`{need.type}`{' (every)' if need.every else ''}{' (optional)' if need.optional else ''}"
        for need in stage.takes.values()
    ]
    yield f"**Takes.** {', '.join(takes) or 'files'}  "
    yield f"**Gives.** {', '.join(f'`{artefact}`' for artefact in stage.gives) or 'files'}  "
    yield from _options(stage, frozenset({"name", "source"}))


def _rule(rule: Any) -> Iterator[str]:
    yield from (f"### `{rule.model_fields['rule'].default}`", "", inspect.cleandoc(rule.__doc__))
    yield from _options(rule)


def _entries(where: str, page: Callable[[Any], Iterator[str]]) -> Iterator[str]:
    """The part about each plug-in of a registry, given as module:name, with an empty line between two."""
    module, _, name = where.partition(":")
    for number, plugin in enumerate(getattr(import_module(module), name)):
        if number:
            yield ""
        yield from page(plugin)


def _stages() -> Iterator[str]:
    yield from _entries("errpipe.stages:STAGES", _stage)
    yield from ("", "## Cleaning rules", "")
    yield from _entries("errpipe.cleaning:RULES", _rule)


def _recordings() -> Iterator[str]:
    yield "## Manifest"
    yield from _options(Manifest)
    yield from ("", "## Columns")
    yield from _options(Column)
    yield from ("", "## Roles and their units, the canonical one first", "")
    yield from _table(("role", "units"), ((f"`{role}`", _units(role)) for role in ROLE_UNITS))
    yield from ("", "## Constants of the set-up")
    yield from _options(Constant)
    yield ""
    yield from _protocols()


def _units(role: str) -> str:
    named = ", ".join(ROLE_UNITS[role]) or "none"
    return f"none (1 while it flows, else 0), {named} ({FLOWING:g} and more: 1)" if role == "coolant" else named


def _protocols() -> Iterator[str]:
    yield from ("## Tests of a machine", "")
    yield inspect.cleandoc("""
        `identify` reads laser and level records of error motions (columns of components EXX, EYX, EBX ... over the
        axis' position) as they are. Give the other axes' positions too, as constant columns: their angles turn the
        line that is read. A straightness is taken at a point on the carriage; of a gauge in the spindle and a
        straightedge on the moving table, state `lasers: {EYX: {read_on: guideway}}`, with the machine file's reference
        of that axis at the tool (`reference_on: guideway`; for an axis on another one, where that one then stood).
        Of an axis that carries the work, `read_on` must be stated if its angles make more than 1 um of difference.
        Error motions of a rotary axis count in directions that stand, as ISO 230-7 reads them; if those of the machine
        file turn with the axis, state `reference_on: carriage` there. Any other recording names its test, and has
        `run`, a position for each axis that moves, and the readings:

        ```yaml
        constants:
          protocol: {value: point_cloud}
          tool_length: {value: 120, unit: mm}      # from the spindle nose to ball or probe; default: the machine file's
        columns:
          run: {role: run}
          x:   {role: position, axis: X, unit: mm}
          y:   {role: position, axis: Y, unit: mm}
          z:   {role: position, axis: Z, unit: mm}
          ex:  {role: error, component: E_X, unit: um}
          ey:  {role: error, component: E_Y, unit: um}
          ez:  {role: error, component: E_Z, unit: um}
        ```

        Positive: the tool is too far on the positive side of the workpiece, in the workpiece's frame. Any constant may
        be of one run: `socket_X@3` holds for run 3. Constants in mm; `seconds` is how long a run took.
        """)
    yield ""
    head = ("protocol", "what is read", "error columns, one or more", "constants")
    rows = ((f"`{n}`", p.measures, ", ".join(p.errors), p.constants) for n, p in PROTOCOLS.items())
    yield from _table(head, rows)


PAGES: Mapping[str, tuple[str, str, Callable[[], Iterator[str]]]] = {
    "terms": (
        "Terms",
        """\
For metrologists. A term is one physical effect: its parameters are fitted, diagnosis tests it as a hypothesis, \
simulation includes it, tables compile it. Deviation = actual minus commanded, um; positions mm, rises K.

```yaml
stages:
  - {kind: simulate}
  - {kind: ingest}
  - kind: fit
    components:
      - component: EXX
        terms:
          - {term: offset}
          - {term: chebyshev, axis: X, degree: 6}
          - {term: scale_expansion, axis: X, sensor: T_nut}
```""",
        partial(_entries, "errpipe.terms:TERMS", _term),
    ),
    "formats": (
        "Measurement file formats",
        """\
For users with a vendor's file. `ingest` detects the format of a file from its content, or reads the named format:

```yaml
stages:
  - {kind: ingest, recording: recordings/x-axis, format: manifest}
```""",
        partial(_entries, "errpipe.formats:FORMATS", _format),
    ),
    "targets": (
        "Controller formats",
        """\
For controls engineers. A correction is minus the deviation. Every format states its sign and is read back as \
the controller reads it; what it cannot express is reported in um, without a constant that setting the zero of a \
linear axis removes. An axis that files leave further off than none, in the mean of valid states, is left out. \
Files that correct in part and turn the part are named: its pose, which the set-up takes, is not counted.

```yaml
stages:
  - {kind: simulate}
  - {kind: ingest}
  - kind: fit
    components:
      - {component: EXX, terms: [{term: offset}, {term: chebyshev, axis: X, degree: 6}]}
  - {kind: validate}
  - {kind: export, targets: [linuxcnc_screw, c_runtime]}
```""",
        partial(_entries, "errpipe.targets:TARGETS", _target),
    ),
    "stages": (
        "Stages of a pipeline",
        """\
For authors of pipelines. Stages run in file order and are linked by the types of their inputs and outputs.

```yaml
pipeline: 1
title: a simulated axis
stages:
  - {kind: simulate}
  - {kind: ingest}
  - {kind: clean}
  - kind: fit
    components:
      - {component: EXX, terms: [{term: offset}, {term: backlash, axis: X}]}
  - {kind: validate}
  - {kind: export}
  - {kind: report}
```""",
        _stages,
    ),
    "recordings": (
        "Recordings",
        """\
For metrologists. A recording is a folder: `recording.yaml` defines every column; nothing is inferred from names.

```yaml
recording: 1
title: X axis, bidirectional positioning
tables: [recording.csv]
constants:
  X: {role: axis, kind: linear, travel: [0, 800], screw_lead: 10, unit: mm}
columns:
  run:   {role: run}
  t:     {role: time, unit: s}
  x:     {role: position, axis: X, unit: mm}
  dir:   {role: direction, axis: X}
  T_nut: {role: temperature, unit: degC, location: ball-screw nut}
  EXX:   {role: error, component: EXX, unit: um}
```""",
        _recordings,
    ),
}


@cache
def page(name: str) -> str:
    """One reference page as Markdown. Raises UsageError for a name that is none of PAGES."""
    if name not in PAGES:
        raise UsageError(f"no reference page {name!r} (allowed: {', '.join(PAGES)}).{did_you_mean(name, PAGES)}")
    title, about, body = PAGES[name]
    note = "<!-- Generated by `errpipe reference --write docs`; edit the code, not this page. -->"
    lines = [f"# {title}", "", note, "", about, "", *body()]
    return "\n".join(line.rstrip() if not line.endswith(".  ") else line for line in lines).rstrip() + "\n"


def entry(page_name: str, name: str) -> str:
    """The part of a page about one plug-in, as Markdown. Raises UsageError naming the nearest."""
    known: dict[str, str] = {}
    for part in re.split(r"(?m)^(?=#{2,3} `)", page(page_name))[1:]:
        of = part.split("`")[1]  # a stage with variants has a part for each
        known[of] = known.get(of, "") + part
    if name not in known:
        hint = did_you_mean(name, known)
        if (Path(__file__).parents[1] / page_name / f"{name}.py").is_file():
            hint = f" There is an errpipe/{page_name}/{name}.py: enter it into the registry in its __init__.py."
        raise UsageError(f"no {page_name} entry {name!r} (allowed: {', '.join(known)}).{hint}")
    return known[name].rstrip() + "\n"


def write(folder: Path) -> list[str]:
    """Write every page into a folder as <name>.md; the names written."""
    for name in PAGES:
        jsonfile.write_text(Path(folder) / f"{name}.md", page(name))
    return [f"{name}.md" for name in PAGES]
