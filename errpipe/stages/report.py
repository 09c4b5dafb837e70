"""One page per run: input, removed rows, fitted terms, held-out figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from errpipe import __version__, jsonfile
from errpipe.errors import DataError
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts
from errpipe.stages._docstrings import equation
from errpipe.stages.validate import HELD_OUT

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel

LOW_COVERAGE = 0.8  # of a 90 % interval in one held-out group; by judgement: twice as many rows outside as stated
SIGN_WARNING = (
    f"{_artefacts.SIGN_NOTE}. Before anything is loaded, jog the axis 0.1 mm (deg) beyond a target in the positive "
    "direction: the reading must rise."
)


class Report(Stage):
    """Write the report, one self-contained HTML file."""

    kind: Literal["report"]
    refusal: str = Field(
        "", description="Why a gate refused the export; set by `errpipe run`, not written in a pipeline file."
    )
    takes: ClassVar[Mapping[str, Need]] = {
        "recording": Need("recording"),
        "ingestions": Need("ingestion", every=True),
        "cleanings": Need("cleaning", optional=True, every=True),
        "error_model": Need("error_model", every=True),
        "validation": Need("validation", every=True),
        "tables": Need("table", optional=True, every=True),
    }
    gives: ClassVar[tuple[str, ...]] = ("report",)
    writes: ClassVar[tuple[str, ...]] = ("report.html",)

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.domain.error_model import joined
        from errpipe.reporting.run_report import RunReport, render
        from errpipe.stages import _iso230_page

        *_, ingestion = context.every("ingestions").values()
        facts = jsonfile.read(ingestion / "ingest.json")
        recording = _artefacts.recording_in(context.needed("recording"))
        exported = {name: jsonfile.read(f / "export.json") for name, f in context.every("tables").items()}
        fits = _fits(context)
        positioning = [_iso230_page.table_and_chart(recording, fit.validation, fit.held_out) for fit in fits]
        page = RunReport(
            title=context.title or facts["title"],
            machine=facts["machine"],
            set_up=[f"{row['what'].capitalize()} {row['value']}" for row in _who_and_when(recording)],
            version=__version__,
            fingerprint=context.fingerprint[:16],
            sources=_sources(facts, recording, fits[-1].validation),
            removed=[
                {"rule": r["rule"].replace("_", " "), "rows": done["count"], "why": f"{done['what']}: {done['reason']}"}
                for folder in context.every("cleanings").values()
                for r in jsonfile.read(folder / "cleaning.json")["rules"]
                for done in r["done"]
            ],
            responses=[one for fit in fits for one in _responses(recording, fit)],
            refusal=self.refusal,
            consequences=[says for document in exported.values() for says in document.get("consequences", ())],
            extra_figures=[
                figure
                for fit, (_, chart) in zip(fits, positioning, strict=True)
                for figure in (*chart, *_family_grids(fit.folder), *_readings(fit.validation))
            ],
            validity=_validity(joined([fit.model for fit in fits])),
            exported=_exported(exported),
            tables=[
                table
                for fit, (figures, _) in zip(fits, positioning, strict=True)
                for table in (*figures, *_family_tables(fit.folder, fit.validation), *_seasons(fit.validation))
            ],
            notes=[*_left_out(exported), *(c for d in exported.values() for c in d.get("checks", ()))],
            warning=SIGN_WARNING if any(_artefacts.sign_noted(fit.model) for fit in fits) else "",
            next_step=_next_step(exported, self.refusal, [c for f in fits for c in f.validation["components"]]),
        )
        context.write_text("report.html", render(page))
        return {"report": "report.html"}


class _Fit(NamedTuple):
    """A fit, its folder, the last validation of it, and the rows that were held out."""

    folder: Path
    model: ErrorModel
    validation: Mapping[str, Any]
    held_out: Path


def _fits(context: Context) -> list[_Fit]:
    """Every fit that was judged. Raises DataError if several were not."""
    validations = {at: jsonfile.read(at / _artefacts.VALIDATION) for at in context.every("validation").values()}
    models = {at: _artefacts.read_model(at / _artefacts.MODEL) for at in context.every("error_model").values()}
    fits = []
    for folder, model in models.items():
        of = _artefacts.fingerprint_of(model)
        judged = [at for at, v in validations.items() if len(models) == 1 or v.get("model") == of]
        if not judged:
            raise DataError(f"report: no validation judged {', '.join(c.component for c in model.components)}")
        fits.append(_Fit(folder, model, validations[judged[-1]], judged[-1] / HELD_OUT))
    return fits


def _sources(facts: Mapping[str, Any], recording: Any, validation: Mapping[str, Any]) -> list[dict[str, Any]]:
    roles: dict[str, list[str]] = {}
    for name, column in facts["columns"].items():
        roles.setdefault(column["role"], []).append(name)
    rows = [
        {"what": "recording", "value": facts["title"]},
        {"what": "rows", "value": f"{facts['rows']}, of which {len(recording)} were kept"},
        {"what": "runs", "value": len(recording.run_labels())},
        *({"what": role.replace("_", " "), "value": ", ".join(names)} for role, names in roles.items()),
        {"what": "held out", "value": _scheme_in_words(validation["scheme"])},
    ]
    if facts["simulated"]:
        rows.insert(1, {"what": "origin", "value": "simulated by errpipe itself; no machine was measured"})
    return rows


def _who_and_when(recording: Any) -> list[dict[str, Any]]:
    """Date, serial number, operator and instrument, where the manifest's constants have them."""
    known = ("date", "serial_number", "operator", "instrument")
    constants = {n: recording.manifest.constants.get(n) for n in known}
    return [{"what": n.replace("_", " "), "value": c.value} for n, c in constants.items() if c is not None]


def _readings(validation: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """What readings of the deviation now and then buy, on groups left out."""
    from errpipe.reporting.run_figures import by_readings

    out = []
    for c in validation["components"]:
        if len(c.get("readings", {}).get("levels", ())) < 2:
            continue
        levels, hours = c["readings"]["levels"], c["readings"]["shift_h"]
        rms = ", ".join(f"{level['per_shift']}: {level['rms']:.3g}" for level in levels)
        caption = (
            f"Rows of the recording serve as readings, with their noise; a shift is {hours:g} h. The share "
            "of a reading that is applied comes from the other groups. "
            f"All groups, readings per shift: rms in {c['unit']}: {rms}. "
            "An export takes readings with readings_per_shift; errpipe predict takes them from a file (--readings)."
        )
        out.append((f"{c['component']}: occasional readings", by_readings(levels, c["component"], c["unit"]), caption))
    return out


def _responses(recording: Any, fit: _Fit) -> list[Any]:
    from errpipe.domain.components import describe
    from errpipe.fitting.recalibration import is_thermal
    from errpipe.reporting.run_report import Response

    held_out = pd.read_parquet(fit.held_out)
    out = []
    for figures in fit.validation["components"]:
        component = next(c for c in fit.model.components if c.component == figures["component"])
        rows_of_component = held_out[held_out["component"] == component.component].sort_values("row", kind="stable")
        index = rows_of_component["row"].to_numpy()
        out.append(
            Response(
                component=component.component,
                unit=figures["unit"],
                deviation=rows_of_component["before"].to_numpy(),
                predicted=(rows_of_component["before"] - rows_of_component["after"]).to_numpy(),
                groups=rows_of_component["group"].tolist(),
                inputs=_columns(recording, fit.model, index),
                rms_before=figures["rms_before"],
                rms_after=figures["rms_after"],
                noise_floor=figures["noise_floor"],
                terms=_terms(component),
                table=[_group(g) for g in figures["groups"]],
                scheme=_scheme_in_words(fit.validation["scheme"]),
                meaning=describe(component.component),
                notes=_notes(component, figures),
                time=recording.time()[index] if is_thermal(recording) else None,
                band=_bands(fit.validation, figures),
                plane=_plane(recording, component.component, index),
            )
        )
    return out


def _bands(validation: Mapping[str, Any], figures: Mapping[str, Any]) -> dict[str, float]:
    """Half width of the 90 % interval by left-out group: the mean of the model's own intervals, or one for all groups.

    The interval is the one whose coverage the table of the groups states.
    """
    table = validation.get("seasons", {})
    rows = table.get("groups", ()) if table.get("component") == figures["component"] else ()
    own = {row["left_out"]: row["half_width"] for row in rows if row["half_width"] is not None}
    if (one := figures.get("half_width90")) is None:
        return own
    return {group["label"]: own.get(group["label"], one) for group in figures["groups"]}


def _scheme_in_words(scheme: str) -> str:
    """leave-one-season-out instead of leave-one-group-out:season."""
    name, _, of = scheme.partition(":")
    return f"leave-one-{of}-out" if of and name == "leave-one-group-out" else scheme


def _plane(recording: Any, component: str, index: Any) -> dict[str, Any]:
    """Axis -> positions, where a deviation of the tool point was measured over two axes; empty elsewhere."""
    from errpipe.domain.components import is_at_tool

    if not is_at_tool(component):
        return {}
    at = {str(recording.manifest.columns[n].axis): recording.array(n)[index] for n in recording.names("position")}
    moving = {axis: x for axis, x in at.items() if x.size and np.nanmax(x) > np.nanmin(x)}
    both = len(moving) == 2 and min(np.unique(np.round(x, 3)).size for x in moving.values()) > 2
    return moving if both and not recording.names("time") else {}


def _columns(recording: Any, model: Any, index: Any) -> dict[str, Any]:
    """Label with unit -> values: inputs of the model first (positions before others), then other columns."""
    columns = recording.manifest.columns
    responses = ("error", "simulated")
    numbers = [n for n, c in columns.items() if c.unit and c.role not in responses and n in recording.frame]
    first = {"position": 0, "time": 1}
    numbers.sort(key=lambda n: (first.get(columns[n].role, 2), n not in model.columns))
    return {f"{n} in {columns[n].unit}": recording.array(n)[index] for n in numbers}


def _terms(component: Any) -> list[dict[str, Any]]:
    """The sentence of each term of a component, for those that have one."""
    from errpipe.fitting.components import term_of

    terms = [(term_of(fitted), fitted) for fitted in component.terms]
    return [_term(term, fitted) for term, fitted in terms if term.has_message(fitted.values())]


def _term(term: Any, fitted: Any) -> dict[str, Any]:
    parameters = [{"name": p.name, "value": p.value, "ci95": p.ci95, "unit": p.unit} for p in fitted.parameters]
    says, of = term.sentence(fitted.values()), _bound_to(term)
    return {"says": says, "equation": equation(type(term)), "of": of, "parameters": parameters}


def _bound_to(term: Any) -> str:
    """What a term is bound to (axis, sensor, column), and the reference that its equation counts from."""
    from errpipe.terms import plain

    bound = plain(term) | ({"reference": term.reference} if hasattr(term, "reference") else {})
    stated = {key: f"{v:g}" if isinstance(v, float) else v for key, v in bound.items() if key != "term"}
    return ", ".join(f"{key.replace('_', ' ')} {v}" for key, v in stated.items() if isinstance(v, str))


def _group(figures: Mapping[str, Any]) -> dict[str, Any]:
    same = {name: figures[name] for name in ("rows", "rms_before", "rms_after", "coverage90")}
    return {"group": figures["label"], **same, **{n: figures[f"{n}_after"] for n in ("bias", "scatter", "worst")}}


def _notes(component: Any, figures: Mapping[str, Any]) -> list[str]:
    from errpipe.validation import between_runs, clocks, steps

    worth = f", equivalent to {component.rows_effective:.0f} independent rows" if component.rows_effective else ""
    notes = [f"{component.rows} rows fitted{worth}. Every rms on this page is of held-out rows."]
    if figures["verdict"] != "model":
        notes.append(f"On held-out rows the best share of this correction is {100 * figures['gain']:.0f} %.")
    found = (steps.in_words(figures), clocks.in_words(figures), between_runs.in_words(figures))
    notes += [f"{words}." for words in found if words]
    notes += _low_coverage(figures["groups"])
    if component.half_width90 is not None:
        more = "" if component.factor90 is None else " where the prediction is small, in a season not in the fit"
        notes.append(f"90 % of new deviations lie within ±{component.half_width90:.3g} {component.unit}{more}.")
    return notes


def _low_coverage(groups: Sequence[Mapping[str, Any]]) -> list[str]:
    """A note on the held-out groups of which the 90 % interval contains too little."""
    known = {g["label"]: g["coverage90"] for g in groups if g["coverage90"] is not None}
    poor = ", ".join(f"{100 * share:.0f} % of {label}" for label, share in known.items() if share < LOW_COVERAGE)
    return [f"The 90 % interval is too narrow in held-out groups: it contains {poor}."] if poor else []


def _validity(model: Any) -> list[dict[str, Any]]:
    return [
        {
            "input": f"{name} in {model.columns.get(name, {}).get('unit') or '1'}",
            "low": low,
            "high": high,
            "outside": _outside_validity(model, name),
        }
        for name, (low, high) in model.validity.ranges.items()
    ]


def _outside_validity(model: Any, name: str) -> str:
    if not model.validity.fades:
        return "fades by design of the model, without a step"
    margin, unit = model.validity.margins.get(name), model.columns.get(name, {}).get("unit") or ""
    unit = "K" if unit == "degC" else unit  # a difference
    seen = model.validity.seen.get(name)
    fitted = f"; fitted from {seen[0]:.4g} to {seen[1]:.4g} only, the rest is an earlier model's range" if seen else ""
    return "held at the end" if margin is None else f"fades to zero over {margin:.3g} {unit}".rstrip() + fitted


def _exported(exported: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Files of every table; with their stage's name before them where there are several stages."""
    heads = {stage: f"{stage}/" if len(exported) > 1 else "" for stage in exported}
    return [{**row, "file": heads[name] + row["file"]} for name, made in exported.items() for row in made["files"]]


def _left_out(exported: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What the gate excluded, scaled down or did not check; which files must be loaded in addition."""
    out: list[str] = []
    for document in exported.values():
        left_out = [
            f"{name} was left out of the table: on held-out rows it was not better than no compensation."
            for name in document["left_out"]
        ]
        out += [document["note"]] if document.get("note") else left_out
        out += [
            f"{j['component']} is applied at {100 * j['gain']:.0f} %: held-out rows were best with that share "
            f"({j['rms_before']:.3g} -> {j['rms_at_gain']:.3g} {j['unit']})."
            for j in document.get("judged", ())
            if 0.0 < j["gain"] < 1.0
        ]
        out += [f"{document['ungated']}."] if document.get("ungated") else []
        out += [f"Sensors: {document['guard']['says']}."] if "guard" in document else []
        out += dict.fromkeys(row["sibling"] for row in document["files"] if row.get("sibling"))
        out += dict.fromkeys(sentence for row in document["files"] for sentence in row.get("worse", ()))
    return out


def _family_tables(folder: Path, validation: Mapping[str, Any]) -> list[Any]:
    """Sections of the model family in the report."""
    from errpipe.reporting.run_report import Table

    family = _artefacts.family_in(folder)
    return [Table(*table) for table in family.tables(_artefacts.documents_in(folder, family), validation)]


def _family_grids(folder: Path) -> list[tuple[str, str, str]]:
    """Grids of figures that the model family adds: heading, SVG, caption."""
    from errpipe.reporting.run_figures import grid

    family = _artefacts.family_in(folder)
    drawn = family.grids(_artefacts.documents_in(folder, family))
    return [(g.heading, grid(g.columns, g.rows, g.values, g.remarks, g.best, g.heading), g.caption) for g in drawn]


def _seasons(validation: Mapping[str, Any]) -> list[Any]:
    """The seasonal tables, where the fit was a thermal model for all seasons."""
    from errpipe.reporting.run_report import Table
    from errpipe.validation.seasons import FIGURES

    headings = {
        "seasons": "Seasons left out whole",
        "forward": "Trained on past months only",
        "forward_daily": "Retrained each day on the past only",
    }
    out = []
    for key, heading in headings.items():
        document = validation.get(key)
        if document is None:
            continue
        rows = [[g["left_out"], *(g[n] for n in FIGURES)] for g in document["groups"]]
        gap = document.get("optimism")
        caption = f"{document['component']} in {document['unit']}, rms unless stated otherwise."
        for month in document.get("months", ()):
            change = f"{month['uncompensated']:.2f} -> {month['out_of_season']:.2f}"
            caption += f" {month['month']}, {month['days']} days: {change}."
        if gap:
            promised = f"{gap['random_rows']:.2f}; whole groups left out keep {gap['groups_left_out']:.2f}"
            caption += f" Random rows would have promised {promised}: the gap is optimism."
        out.append(Table(heading, ["left out", *(n.replace("_", " ") for n in FIGURES)], rows, caption))
    return out


def _next_step(exported: Mapping[str, Any], refusal: str, figures: Sequence[Mapping[str, Any]]) -> str:
    if refusal:
        return "read why the export was refused; correct the recording or the model, then errpipe run again."
    if not exported and all(c["rms_after"] >= c["rms_before"] for c in figures):
        return (
            "do not export this model: on held-out rows it is not better than no compensation. Record further runs, "
            "or fit fewer terms."
        )
    if not exported:
        return "add an export stage to compile this model into a table that a controller runs."
    if any("/" in row["file"] for document in exported.values() for row in document["files"]):
        return (
            "follow CHECKLIST.md next to each controller file: its sign, the numbers to enter, three points to compare."
        )
    return "errpipe whatis on the exported table.ect shows what a cycle costs; errpipe verify re-reads every file."
