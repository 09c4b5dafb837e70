"""Report of a fleet: worst machines first, drifting machines, homogeneous groups, pooled parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from errpipe import jsonfile
from errpipe.domain.error_model import ErrorModel
from errpipe.reporting.markup import plain_text
from errpipe.stages import _artefacts
from errpipe.verbs import _fleet_types

VERSION = 1  # of the document's layout
WRITERS = 8  # files that wait for the disk at a time
DOCUMENT, PAGE, POOLED = "fleet.json", "fleet.md", "pooled"


def model_of(result: Mapping[str, Any]) -> ErrorModel | None:
    """The model of one machine's run, None where it has none."""
    return ErrorModel.model_validate(result["parameters"]) if result.get("parameters") else None


def write_report(
    title: str,
    pool: bool,
    types: Mapping[str, str],
    results: Sequence[Mapping[str, Any]],
    models: Mapping[str, ErrorModel | None],
    out: Path,
) -> dict[str, Any]:
    """Write fleet.json and fleet.md, and the pooled models where asked for; the document."""
    keep = ("name", "state", "message", "responses", "drift", "model")
    rows = [
        {"type": types[r["name"]], "borrows": r.get("borrows", False), **{key: r[key] for key in keep}} for r in results
    ]
    for path in (out / POOLED).glob(f"*/{_artefacts.MODEL}") if pool else ():
        if models.get(path.parent.name) is None:  # of an earlier run of the fleet
            path.unlink()
    types_of = [_type(name, rows, models, out, pool) for name in sorted(set(types.values()))]
    document = {
        "fleet": VERSION,
        "title": title,
        "machines": sorted(rows, key=_sort_key),
        "drifting": [{"name": r["name"], **d} for r in rows for d in r["drift"]],
        "suspicious": [
            *(f"{r['name']}: {why}" for r in results for why in r.get("not_judged", ())),
            *_suspicious(results, types_of),
        ],
        "types": types_of,
    }
    jsonfile.write(out / DOCUMENT, document)
    jsonfile.write_text(out / PAGE, "\n".join([*lines(document), ""]))
    return document


def _suspicious(results: Sequence[Mapping[str, Any]], types_of: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warnings that only a comparison of machines gives."""
    out = [f"{', '.join(names)}: the same readings; one recording under several names?" for names in _copies(results)]
    for kind in types_of:
        for component, response in kind["responses"].items():
            for name in response["mirrored"]:
                out.append(f"{name}: {component} has the opposite sign of its type; was it declared correctly?")
    return out


def _copies(results: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Machines whose cleaned readings are the same bytes, in groups of two and more."""
    by_digest: dict[str, list[str]] = {}
    for r in results:
        if r.get("readings"):
            by_digest.setdefault(r["readings"], []).append(r["name"])
    return [names for names in by_digest.values() if len(names) > 1]


def _sort_key(row: Mapping[str, Any]) -> tuple[int, float, str]:
    """Failed ones first, then by the largest rms that is left on held-out rows."""
    largest_rms = max((c["rms_after"] for c in row["responses"].values()), default=0.0)
    return (("failed", "refused", "done").index(row["state"]), -largest_rms, row["name"])


def _type(
    name: str, rows: Sequence[Mapping[str, Any]], of_machines: Mapping[str, ErrorModel | None], out: Path, pool: bool
) -> dict[str, Any]:
    """Machines of a type that are alike, and its pooled parameters; models of machines that borrowed are pooled."""
    models = {r["name"]: m for r in rows if r["type"] == name and (m := of_machines[r["name"]]) is not None}
    borrowed = {r["name"]: models.pop(r["name"]) for r in rows if r["borrows"] and r["name"] in models}
    responses = _fleet_types.responses(models)
    if pool:
        for component, response in responses.items():
            _fleet_types.shrink_to_type(models, component, response)
        models |= borrowed
        paths = [out / POOLED / machine / _artefacts.MODEL for machine in models]
        with ThreadPoolExecutor(WRITERS) as writers:
            list(writers.map(jsonfile.write, paths, map(_artefacts.model_json, models.values())))
    return {"type": name, "responses": responses}


def lines(document: Mapping[str, Any]) -> list[str]:
    rows = document["machines"]
    states = [r["state"] for r in rows]
    out = [f"# {plain_text(document['title'] or 'Fleet')}: {len(rows)} machines", ""]
    out += [
        f"{states.count('done')} done, {states.count('refused')} refused by a gate, {states.count('failed')} failed.",
        "",
    ]
    out += [
        "| machine | type | state | response | before | after | noise floor |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in rows:
        head = f"| {r['name']} | {plain_text(r['type'])} | {r['state']} "
        out += [head + "| | | | |"] if not r["responses"] else []
        for name, c in r["responses"].items():
            floor = "unknown" if c["noise_floor"] is None else f"{c['noise_floor']:.3g}"
            out.append(f"{head}| {name} | {c['rms_before']:.3g} | {c['rms_after']:.3g} {c['unit']} | {floor} |")
    out += ["", "rms on held-out rows, in the unit given after `after`; largest first.", "", "## What went wrong", ""]
    wrong = [*(f"{r['name']}: {r['message']}" for r in rows if r["message"]), *document["suspicious"]]
    out += [f"- {plain_text(text)}" for text in wrong] or ["Nothing."]
    out += ["", "## Machines that drift", ""]
    for d in document["drifting"]:
        out.append(
            f"- {d['name']}: {plain_text(d['what'])} since run {plain_text(d['since'])}: {d['size']:+.3g} {d['unit']}"
        )
    out += [] if document["drifting"] else ["None."]
    out += ["", "## Machines alike", "", "Machines whose parameters the data do not tell apart (95 %).", ""]
    for kind in document["types"]:
        for component, response in kind["responses"].items():
            groups = [", ".join(group) for group in response["alike"]]
            name = plain_text(", ".join(filter(None, (kind["type"], component))))
            out += [f"- {name}: {group}" for group in groups] or [f"- {name}: none"]
    return out
