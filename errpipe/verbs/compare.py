"""`errpipe compare`: what changed between two artefacts of a kind, where, and by how many micrometres."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from errpipe import jsonfile
from errpipe.domain.diagnosis import Diagnosis
from errpipe.domain.error_model import ErrorModel
from errpipe.domain.table import CompensationTable
from errpipe.errors import DataError, UsageError, VerifyError, first_problem
from errpipe.stages import _artefacts
from errpipe.tables import by_component, ect
from errpipe.validation import changes
from errpipe.validation.changes import Change, Comparison, Compensation
from errpipe.verbs import _compare_files

if TYPE_CHECKING:
    from errpipe.pipeline.lock import Record

VERSION = 1  # of the document's layout
DIAGNOSIS = "diagnosis.json"
EXPORT = "export.json"  # of an export folder
DIGITS = 9  # of a position in mm (deg, K): ends of grids are start + step * count, with rounding
SETTLED = 0.5  # of the largest difference: less than that once settled is worth a line
MAX_LISTED = 12  # lines of one kind in a text; the JSON document has all


def compare(old: Path, new: Path, max_um: float | None = None, figure: Path | None = None) -> dict[str, Any]:
    """The document of `errpipe compare`: kind, what changed, largest_um, rms_um, within (None without a limit).

    Raises DataError if the two are not of one kind or nothing is known of one, VerifyError for a damaged one.
    """
    if figure is not None and Path(figure).suffix.lower() != ".svg":
        raise UsageError(f"--figure {figure}: is drawn as SVG (a name that ends in .svg)")
    folders = [p / "run" if (p / "retrain.json").is_file() else p for p in map(Path, (old, new))]  # of retrain: its run
    old, new = (p / _artefacts.TABLE if (p / EXPORT).is_file() else p for p in folders)
    kinds = kind_of(old), kind_of(new)
    correcting = {"table", "model"}
    if kinds[0] != kinds[1] and not set(kinds) <= correcting:
        raise DataError(f"{old} is a {kinds[0]} and {new} is a {kinds[1]}: two of one kind can be compared")
    result = HOW[kinds[0] if kinds[0] == kinds[1] else "model"](old, new)
    if all((p / EXPORT).is_file() for p in folders):
        result.lines += _compare_files.differing(*folders)
    result.lines = result.lines or ["nothing changed"]
    within = None
    if max_um is not None:
        within = result.largest is not None and result.largest <= max_um
        seen = "no figure of the difference" if result.largest is None else f"at most {result.largest:.4g}"
        result.lines.append(f"limit {max_um:g}: {seen}: {'within' if within else 'NOT within the limit'}")
    if figure is not None:
        from errpipe.verbs._compare_page import draw

        jsonfile.write_text(figure, draw(result.changes, result.findings))
        result.lines.append(str(figure))
    figures = {"largest_um": result.largest, "rms_um": result.rms, "within": within}
    return {"compare": VERSION, "kind": result.kind, **figures, **result.parts, "says": result.lines}


def kind_of(path: Path) -> str:
    """table, model, recording, diagnosis, run folder or fleet. Raises DataError for anything else."""
    if path.is_dir():
        marks = {"errpipe.lock": "run folder", "recording.yaml": "recording", "fleet.json": "fleet"}
        if kinds := [kind for name, kind in marks.items() if (path / name).is_file()]:
            return kinds[0]
        raise DataError(f"{path}: a folder without {', '.join(marks)}, {EXPORT} or retrain.json: nothing to compare")
    if not path.is_file():
        raise DataError(f"{path}: there is no such file or folder")
    if path.name == "recording.yaml":
        return "recording"
    if path.suffix == ".ect" or ect.sniff(path):
        return "table"
    value = jsonfile.read(path) if path.suffix == ".json" else None
    if isinstance(value, dict):
        for key, kind in (("table", "table"), ("error_model", "model"), ("diagnosis", "diagnosis")):
            if key in value:
                return kind
    raise DataError(
        f"{path}: not a table, model, recording, diagnosis or run folder (`errpipe import` converts others)"
    )


# ---------------------------------------------------------------- tables and models


def _tables(old: Path, new: Path) -> Comparison:
    before, after = _artefacts.read_table(old), _artefacts.read_table(new)
    out = Comparison("table")
    _settings(out, before, after)
    _sign_warning(out, before, after)
    _fields(out, changes.of_table(before), changes.of_table(after))
    return out


def _sign_warning(out: Comparison, *sides: CompensationTable | ErrorModel) -> None:
    """Which side holds for readings of an assumed sign: the difference of two is then no evidence for either."""
    assumed = [
        _artefacts.SIGN_ASSUMED in s.title or (isinstance(s, ErrorModel) and _artefacts.sign_noted(s)) for s in sides
    ]
    out.parts["sign_assumed"] = assumed
    words = {(True, True): "both", (True, False): "the old one", (False, True): "the new one"}
    if where := words.get((assumed[0], assumed[1])):
        out.lines.append(f"{where}: {_artefacts.SIGN_NOTE}")


def _settings(out: Comparison, old: CompensationTable, new: CompensationTable) -> None:
    """What a table states beside its curves: identity, inputs, outputs and their limits, cycles."""
    names = ect.fingerprint(old), ect.fingerprint(new)
    out.parts["identity"] = list(names)
    if names[0] != names[1]:
        out.lines.append(f"table {names[0]} -> {names[1]}")
    for what, pair in (("input", (old.inputs, new.inputs)), ("output", (old.outputs, new.outputs))):
        before, after = ({part.name: part.model_dump(mode="json") for part in parts} for parts in pair)
        _keys(out, what, before, after)
        for name, a, b in _shared(before, after):
            for key, was, now in ((k, _short(v), _short(b[k])) for k, v in a.items()):
                out.lines += [f"{what} {name}: {key} {was} -> {now}"] if was != now else []
    for key in ("machine", "title", "position_cycle_s", "thermal_cycle_s"):
        if getattr(old, key) != getattr(new, key):
            out.lines.append(f"{key}: {_short(getattr(old, key))} -> {_short(getattr(new, key))}")


def _models(old: Path, new: Path) -> Comparison:
    before, after = _artefacts.model_or_table(old), _artefacts.model_or_table(new)
    out = Comparison("model")
    if isinstance(before, ErrorModel) and isinstance(after, ErrorModel):
        _parameters(out, before, after)
    _sign_warning(out, before, after)
    seen: list[Compensation] = [
        changes.of_model(side) if isinstance(side, ErrorModel) else changes.of_table(by_component(side))
        for side in (before, after)
    ]
    _fields(out, *seen)
    return out


def _parameters(out: Comparison, old: ErrorModel, new: ErrorModel) -> None:
    before, after = _by_parameter(old), _by_parameter(new)
    _keys(out, "parameter", before, after)
    moved = []
    for name, a, b in _shared(before, after):
        if a.value == b.value:
            continue
        within = None if a.ci95 is None else a.ci95[0] <= b.value <= a.ci95[1]
        moved.append({"parameter": name, "old": a.value, "new": b.value, "unit": a.unit, "within_ci95": within})
        word = "" if within is None else f", {'inside' if within else 'outside'} its 95 % interval"
        if f"{a.value:.4g}" != f"{b.value:.4g}":
            out.lines.append(f"{name}: {a.value:.4g} -> {b.value:.4g} {a.unit}{word}")
    out.parts["parameters"] = moved


def _by_parameter(model: ErrorModel) -> dict[str, Any]:
    """ "COMPONENT term(its settings).parameter" -> parameter, of every compensated term."""
    out = {}
    for component in model.components:
        for term in component.terms:
            settings = ", ".join(str(v) for k, v in term.term.items() if k != "term" and isinstance(v, str))
            for p in term.parameters:
                out[f"{component.component} {term.term['term']}({settings}).{p.name}"] = p
    return out


def _fields(out: Comparison, old: Compensation, new: Compensation) -> None:
    """Ranges of validity that differ; largest and rms difference per response, with the place."""
    new, same = changes.one_axis_one_name(old, new)
    out.lines += [
        f"{was} in the old one and {now} in the new one are one axis: evaluated as one" for now, was in same.items()
    ]
    _ranges(out, old.ranges, new.ranges)
    differences = changes.compare(old, new)
    out.parts["changes"] = [asdict(c) for c in differences]
    for c in differences:
        out.widen(c.largest, c.rms)
        out.changes.append((c.component, c))
        if c.largest == 0.0:
            out.lines.append(f"{c.component}: the same")
            continue
        out.lines.append(f"{c.component}: differs by at most {c.largest:.4g} {c.unit} ({c.rms:.4g} rms over validity)")
        if c.settled < SETTLED * c.largest:
            out.lines.append(f"    by at most {c.settled:.4g} {c.unit} once settled: they follow a step at other rates")
        out.lines += _where(c)


def _where(c: Change) -> list[str]:
    """Lines on where a response differs most, and what the difference correlates with."""
    place = ", ".join(f"{name} = {round(value, DIGITS) + 0.0:.5g}" for name, value in c.at.items())
    lines = [f"    most at {place}: {c.old:+.4g} -> {c.new:+.4g} {c.unit}"]
    if c.goes_with and c.share > 0.1:
        means = [b[1] for b in c.by_bin]
        low, high = means.index(min(means)), means.index(max(means))
        lines.append(
            f"    {c.share:.0%} of it correlates with {c.goes_with}: on average {means[low]:+.3g} {c.unit} near "
            f"{c.by_bin[low][0]:.4g}, {means[high]:+.3g} near {c.by_bin[high][0]:.4g}"
        )
    return lines


# ---------------------------------------------------------------- recordings, diagnoses, run folders


def _recordings(old: Path, new: Path) -> Comparison:
    before, after = (_artefacts.recording_in(p.parent if p.is_file() else p) for p in (old, new))
    out = Comparison("recording")
    _keys(out, "column", before.manifest.columns, after.manifest.columns)
    own = before.manifest.columns
    columns = _shared(own, after.manifest.columns)
    out.lines += [f"column {name}: is declared differently" for name, a, b in columns if a != b]
    same_meaning = {name for name, a, b in columns if _meaning_of_column(a) == _meaning_of_column(b)}
    _keys(out, "run", dict.fromkeys(before.run_labels()), dict.fromkeys(after.run_labels()))
    if len(before) != len(after):
        out.lines.append(f"rows: {len(before)} -> {len(after)}")
    shared = changes.shared_runs(before, after)
    moved = {n: f for n, f in changes.rows_changed(before, after).items() if n in same_meaning} if shared else {}
    out.parts |= {"shared_runs": shared, "columns": moved}
    for name, figures in moved.items():
        unit = own[name].unit or ""
        out.lines.append(
            f"{name}: {figures['rows']} rows of shared runs differ, by at most {figures['largest']:.4g} {unit}"
        )
        if own[name].role == "error":
            change = changes.of_rows(before, after, name)
            out.changes.append((name, change))
            out.lines += _where(change)
    single = [n for r in (before, after) for n in r.names("error") if n not in same_meaning]
    if single:
        out.lines.append(f"deviations that only one of the two holds: {', '.join(dict.fromkeys(single))}")
    elif shared:
        errors = [moved[n] for n in before.names("error") if n in moved]
        out.widen(max((e["largest"] for e in errors), default=0.0), max((e["rms"] for e in errors), default=0.0))
    return out


def _meaning_of_column(column: Any) -> tuple[Any, ...]:
    """What a column holds, whatever it states of its source: columns of another axis are no change of this one."""
    return column.role, column.axis, column.component, column.unit


def _diagnoses(old: Path, new: Path) -> Comparison:
    before, after = _diagnosis(old), _diagnosis(new)
    out = Comparison("diagnosis", parts={"responses": {}})
    _keys(out, "response", before, after)
    for one in [*(r for n, r in before.items() if n not in after), *(r for n, r in after.items() if n not in before)]:
        size = max((f.rms_um for f in one.findings), default=0.0)
        out.widen(size, size)
    for name, a, b in _shared(before, after):
        if a.verdict != b.verdict:
            out.lines.append(f"{name}: {a.verdict} -> {b.verdict}")
        effects = [{f.effect: f for f in r.findings} for r in (a, b)]
        for effect in dict.fromkeys([*effects[0], *effects[1]]):
            was, now = (side.get(effect) for side in effects)
            size = [f.rms_um if f is not None else 0.0 for f in (was, now)]
            out.widen(abs(size[1] - size[0]), abs(size[1] - size[0]))
            out.findings.append((f"{name}: {effect}", size[0], size[1]))
            _finding(out, name, effect, was, now, a.unit)
        figures = [r.holdout.rms_after_um for r in (a, b)]
        if figures[0] != figures[1]:
            out.lines.append(f"{name}: {figures[0]:.4g} -> {figures[1]:.4g} {a.unit} rms left on held-out rows")
        out.widen(0.0, 0.0)
        part = {"verdict": [a.verdict, b.verdict], "effects": [sorted(side) for side in effects]}
        out.parts["responses"][name] = part | {"rms_left": figures}
    return out


def _finding(out: Comparison, name: str, effect: str, was: Any, now: Any, unit: str) -> None:
    if was is None or now is None:
        word, f = ("is new", now) if was is None else ("is gone", was)
        out.lines.append(f"{name}: {effect} {word} ({f.rms_um:.3g} {unit} rms, confidence {f.confidence:.2f})")
        return
    values = {p.name: p for p in was.parameters}
    for p in now.parameters:
        if p.name in values and values[p.name].value != p.value:
            out.lines.append(f"{name}: {effect}.{p.name} {values[p.name].value:.4g} -> {p.value:.4g} {p.unit}")
    if abs(was.confidence - now.confidence) >= 0.005:
        out.lines.append(f"{name}: {effect} confidence {was.confidence:.2f} -> {now.confidence:.2f}")


def _diagnosis(path: Path) -> dict[str, Any]:
    try:
        return {r.component: r for r in Diagnosis.model_validate(jsonfile.read(path)).responses}
    except ValidationError as err:
        raise VerifyError(f"{path}: not a diagnosis: {first_problem(err)}") from None


def _run_folders(old: Path, new: Path) -> Comparison:
    """Stages whose parameters, inputs or code differ, and every artefact that both runs left and that differs."""
    from errpipe.pipeline.lock import changes, read_lock

    before, after = read_lock(old), read_lock(new)
    out = Comparison("run folder", parts={"stages": {}})
    _keys(out, "stage", before, after)
    for name, a, b in _shared(before, after):
        reasons = changes(_without_files(a), _without_files(b)) or changes(a, b)[:3]
        out.lines += [f"{name}: {reason}" for reason in reasons]
        files = _shared(a.outputs, b.outputs)
        parts = {f: _part(out, name, f, old / name / f, new / name / f, was == now) for f, was, now in files}
        known = {file: part for file, part in parts.items() if part is not None}
        out.parts["stages"][name] = {"reasons": reasons, "artefacts": known}
    return out


def _fleets(old: Path, new: Path) -> Comparison:
    """The run of every machine that both fleets ran, those that differ most first."""
    sides = [{p.parent.name: p.parent for p in sorted(f.glob("machines/*/errpipe.lock"))} for f in (old, new)]
    out = Comparison("fleet", parts={"machines": {}})
    _keys(out, "machine", *sides)
    each = [(name, _run_folders(a, b)) for name, a, b in _shared(*sides)]
    for place, (name, run) in enumerate(sorted(each, key=lambda pair: -(pair[1].largest or 0.0))):
        out.parts["machines"][name] = {"largest_um": run.largest, "rms_um": run.rms, "says": run.lines}
        if run.largest is not None:
            out.widen(run.largest, run.rms or 0.0)
        if run.largest and place < MAX_LISTED:
            out.lines.append(f"{name}: differs by at most {run.largest:.4g} um ({run.rms:.4g} rms)")
        out.changes += [(f"{name}, {what}", change) for what, change in run.changes if change.largest]
    return out


def _without_files(record: Record) -> Record:
    """A record with its own inputs alone: what other stages wrote is compared under those stages."""
    return replace(record, inputs={name: value for name, value in record.inputs.items() if "/" not in name})


ARTEFACTS = (_artefacts.TABLE, _artefacts.MODEL, DIAGNOSIS, "recording.yaml")


def _part(out: Comparison, stage: str, file: str, old: Path, new: Path, same: bool) -> dict[str, Any] | None:
    """Figures of one artefact of a run. A recording's do not count for the run: its rows are no compensation."""
    if file == _artefacts.VALIDATION:
        return _validation(out, stage, old, new)
    if file not in ARTEFACTS:
        return None
    if same and file != "recording.yaml":
        if file in (_artefacts.TABLE, _artefacts.MODEL):
            out.widen(0.0, 0.0)
        return None
    comparison = HOW[kind_of(old)](old, new)
    if file in (_artefacts.TABLE, _artefacts.MODEL) and comparison.largest is not None:
        out.widen(comparison.largest, comparison.rms or 0.0)
        out.changes += [(f"{stage}: {name}", c) for name, c in comparison.changes]
    out.lines += [f"{stage}: {line}" for line in comparison.lines]
    out.findings += [(f"{stage}: {name}", was, now) for name, was, now in comparison.findings]
    return {"largest_um": comparison.largest, "rms_um": comparison.rms, **comparison.parts}


def _validation(out: Comparison, stage: str, old: Path, new: Path) -> dict[str, Any]:
    """Held-out rms of every response, before and after."""
    sides = [{c["component"]: c for c in jsonfile.read(p)["components"]} for p in (old, new)]
    rms_left = {}
    for name, was, now in _shared(*sides):
        rms_left[name] = [was["rms_after"], now["rms_after"]]
        a, b = (f"{rms:.4g}" for rms in rms_left[name])
        out.lines += [f"{stage}: {name} {a} -> {b} {was['unit']} rms on held-out rows"] if a != b else []
    return rms_left


HOW: Mapping[str, Callable[[Path, Path], Comparison]] = {
    "table": _tables,
    "model": _models,
    "recording": _recordings,
    "diagnosis": _diagnoses,
    "run folder": _run_folders,
    "fleet": _fleets,
}


# ---------------------------------------------------------------- words


def _keys(out: Comparison, what: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Names that only one of the two has."""
    gone, added = [n for n in old if n not in new], [n for n in new if n not in old]
    out.parts.setdefault("only_in_old", {})[what] = gone
    out.parts.setdefault("only_in_new", {})[what] = added
    for names, word in ((gone, "only in the old one"), (added, "only in the new one")):
        if names:
            more = f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else ""
            out.lines.append(f"{what} {word}: {', '.join(names[:MAX_LISTED])}{more}")


def _shared(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """(name, old value, new value) of the names that both have."""
    return [(name, value, new[name]) for name, value in old.items() if name in new]


def _ranges(out: Comparison, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    for name, a, b in _shared(old, new):
        if all(abs(p - q) < 10.0**-DIGITS for p, q in zip(a, b, strict=True)):
            continue
        disjoint = a[0] < a[1] <= b[0] < b[1] or b[0] < b[1] <= a[0] < a[1]
        was, now = (" .. ".join(f"{round(end, DIGITS) + 0.0:.5g}" for end in ends) for ends in (a, b))
        out.lines.append(f"validity of {name}: {was} -> {now}" + disjoint * ", apart")


def _short(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else jsonfile.dumps(value, indent=None).strip()
    return text if len(text) <= 60 else text[:57] + "..."
