"""Controller files: written, read back as the controller would, compared with the table, with a checklist."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from errpipe.errors import GateError, UsageError, did_you_mean
from errpipe.files import inside
from errpipe.stages import _artefacts, _plausible

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable

CHECKLIST = "CHECKLIST.md"
DIGITS = 6  # of a loss in um: what lies below is rounding, which differs between machines and would fail `verify`


def targets() -> dict[str, Any]:
    """All formats with their controller, confidence, sign and limits."""
    from errpipe.targets import TARGETS

    rows = [
        {
            "name": t.name,
            "controller": t.controller,
            "confidence": t.confidence,
            "sign": t.sign,
            "limits": t.limits,
            "goes_with": list(t.goes_with),
        }
        for t in TARGETS
    ]
    return {"targets": rows, "says": [_described(row) for row in rows]}


def _described(row: dict[str, Any]) -> str:
    line = f"{row['name']:<22} {row['confidence']:<13} {row['controller']}\n    {row['sign']}; {row['limits']}"
    return line + (f"\n    goes with {', '.join(row['goes_with'])}" if row["goes_with"] else "")


def compare_targets(table: Path) -> dict[str, Any]:
    """What each controller would lose of a table, in micrometres, on settled states inside validity."""
    from errpipe.targets import TARGETS

    found = _artefacts.read_table(table)
    rows: list[dict[str, Any]] = []
    for target in TARGETS:
        try:
            lost = losses(found, target, target.write(found))
        except GateError as err:
            rows.append({"target": target.name, "refused": str(err)})
            continue
        rows += [{"target": target.name, **loss} for loss in lost]
    rows += [{"target": " + ".join(names), **loss} for names, lost in _best_together(found) for loss in lost]
    return {"comparison": rows, "says": [_line(row) for row in rows]}


def together(targets: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Every choice of two or more targets whose files one controller adds up."""
    from itertools import combinations

    def add_up(a: Any, b: Any) -> bool:
        return b.name in a.goes_with or a.name in b.goes_with

    most = max((len(t.goes_with) for t in targets), default=0) + 1
    found = [c for size in range(2, most + 1) for c in combinations(targets, size)]
    return [c for c in found if all(add_up(a, b) for a, b in combinations(c, 2))]


def write_together(table: CompensationTable, parts: Sequence[Any]) -> tuple[list[dict[str, str]], Any]:
    """Files of each part, none saying what another one says, and what the controller makes of all. Raises GateError."""
    files = [part.write_beside(table, [o.name for o in parts if o is not part]) for part in parts]
    first, *rest = (part.read_back(own) for part, own in zip(parts, files, strict=True))
    return files, sum(rest, start=first)


def _best_together(table: CompensationTable) -> list[tuple[tuple[str, ...], list[dict[str, Any]]]]:
    """For each family of formats, the choice that loses least (root of summed squares over the axes)."""
    from errpipe.targets import TARGETS

    best: dict[str, tuple[float, tuple[str, ...], list[dict[str, Any]]]] = {}
    for parts in together(TARGETS):
        try:
            _, read = write_together(table, parts)
        except GateError:
            continue
        lost = _loss_rows(table, read)
        size, names = sum(x["rms_um"] ** 2 for x in lost), tuple(p.name for p in parts)
        family = min((names[0], *parts[0].goes_with))
        if family not in best or size < best[family][0]:
            best[family] = (size, names, lost)
    return [(names, lost) for _, names, lost in best.values()]


def export(
    table: Path,
    names: Sequence[str],
    out: Path,
    allow: Sequence[str] = (),
    limit: float | None = None,
    public_key: Path | None = None,
) -> dict[str, Any]:
    """The files of named targets, beside a copy of the table they come from, in a folder that `verify` reads.

    allow, limit: as the options of the export stage (limit in um). public_key: the table must be signed by it, and
    its signature goes along. Raises GateError for an implausible correction, VerifyError where it is not signed.
    """
    from errpipe import jsonfile
    from errpipe.tables import ect

    found, remarks, signature = _signed(table, public_key) if public_key else (_artefacts.read_table(table), (), "")
    _plausible.refuse_table(found, allow, limit)
    files = write_targets(found, names, Path(out), remarks)
    ect.write(found, Path(out) / _artefacts.TABLE)
    if signature:
        jsonfile.write_text(Path(out) / f"{_artefacts.TABLE}.minisig", signature)
    ect.write_json(found, Path(out) / _artefacts.TWIN)
    consequences = _plausible.of_table(found)
    document = {"export": 1, "inputs": found.fingerprint, "proof": [], "files": files, "left_out": []}
    document["consequences"] = consequences
    document["sha256"] = checksums(Path(out), files, [_artefacts.TABLE, _artefacts.TWIN])
    jsonfile.write(Path(out) / "export.json", document)
    return {
        "files": files,
        "says": [*(f"{Path(out) / f['file']}: {f['what']}, lost: {f['error']}" for f in files), *consequences],
    }


def _signed(table: Path, public_key: Path) -> tuple[CompensationTable, tuple[str, ...], str]:
    """A table whose signature holds, the remarks for its files, the signature."""
    from errpipe.registry import minisign, signed

    key, signature = minisign.read_public(public_key), minisign.signature_of(table)
    found = signed.read_table(table, key)
    return found, signed.remarks(found, signature, key), signature


def checksums(folder: Path, files: Iterable[dict[str, Any]], others: Iterable[str] = ()) -> dict[str, str]:
    """SHA-256 of every exported file by its path in the folder, with the checklists of the targets."""
    names = {row["file"] for row in files} | set(others)
    names |= {f"{name.split('/')[0]}/{CHECKLIST}" for name in names if "/" in name}
    return {name: hashlib.sha256(inside(folder, name, GateError).read_bytes()).hexdigest() for name in sorted(names)}


def write_targets(
    table: CompensationTable, names: Sequence[str], folder: Path, remarks: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """Write the files of each named target into a folder of its own. Raises UsageError for an unknown name.

    remarks: lines for people, such as the table's signature; written where a format has room for comments.
    """
    from errpipe import jsonfile

    out = []
    targets = with_something_to_add(table, chosen(list(dict.fromkeys(names))))
    for target in targets:
        others = _sibling_names(target, targets)
        files = target.remarked(target.write_beside(table, others), remarks)
        lost = losses(table, target, files)
        for name, text in files.items():
            jsonfile.write_text(inside(folder, f"{target.name}/{name}", GateError), text)
        steps = checklist(target, target.read_back(files), lost, table) + _companions(table, target, others)
        jsonfile.write_text(folder / target.name / CHECKLIST, steps)
        out += [
            {
                "file": f"{target.name}/{name}",
                "what": target.controller,
                "error": in_words(lost),
                "read_back": "compared",
                "losses": lost,
            }
            for name in files
        ]
    return out


def with_something_to_add(table: CompensationTable, targets: Sequence[Any]) -> list[Any]:
    """The targets without those whose companions say already all that they could."""
    from errpipe.targets._base import NothingToAddError

    left = list(targets)
    for target in targets:
        try:
            target.write_beside(table, _sibling_names(target, left))
        except NothingToAddError:
            left.remove(target)
    return left


def _companions(table: CompensationTable, target: Any, others: Sequence[str]) -> str:
    """What a checklist says of files that are loaded besides; nothing where there are none."""
    if not others:
        return ""
    _, read = write_together(table, [target, *chosen(others)])
    return (
        f"\nLoad these files only together with those of {', '.join(others)}: what they say is left out here.\n"
        f"Together they leave {in_words(_loss_rows(table, read))}.\n"
    )


def _sibling_names(target: Any, targets: Sequence[Any]) -> list[str]:
    """Names of the other targets of an export that go with one."""
    return [o.name for o in targets if o is not target and (o.name in target.goes_with or target.name in o.goes_with)]


def chosen(names: Sequence[str]) -> list[Any]:
    """Targets by name. Raises UsageError with the nearest name."""
    from errpipe.targets import TARGETS

    known = {t.name: t for t in TARGETS}
    for name in names:
        if name not in known:
            raise UsageError(f"no target {name!r} (targets: {', '.join(known)}).{did_you_mean(name, known)}")
    return [known[name] for name in names]


def _loss_rows(table: CompensationTable, read: Any) -> list[dict[str, Any]]:
    """Losses per axis on random states inside validity, many of them at its ends: no bound, and not called one."""
    from errpipe.targets import _sample

    return [
        {
            "axis": x.axis,
            "largest_um": round(x.largest, DIGITS),
            "rms_um": round(x.rms, DIGITS),
            "table_rms_um": round(x.table_rms, DIGITS),
            "states": _sample.STATES,
        }
        for x in _sample.loss(table, read)
    ]


def losses(table: CompensationTable, target: Any, files: dict[str, str]) -> list[dict[str, Any]]:
    """What a target's files lose of a table, per axis in um, as `export.json` keeps it."""
    return _loss_rows(table, target.read_back(files))


def in_words(lost: list[dict[str, Any]]) -> str:
    """Losses in words."""
    seen = f" um on {lost[0]['states']} states" if lost else " nothing: no axis is moved"
    return "; ".join(f"{x['axis']} {x['rms_um']:.3g} rms, {x['largest_um']:.3g} largest seen" for x in lost) + seen


def checklist(target: Any, read: Any, lost: list[dict[str, Any]], table: CompensationTable) -> str:
    """What a person at the machine does: sign, activation, moves with expected values, what is lost."""
    lines = [f"# {target.name}: {target.controller}", "", f"Sign: {target.sign}.", f"Limits: {target.limits}."]
    if table.title.startswith(_artefacts.UNGATED):
        lines += [
            "",
            f"**{_artefacts.UNGATED}.** Measure before and after, and take it off where it is not better.",
            "",
        ]
    lines += [f"Source: {target.source}. Confidence: {target.confidence}.", "", "## What will happen", ""]
    read = _within_travel(read, table)
    lines += [f"- {says}." for says in (*_plausible.of_files(read), *_at_the_axis(table))] + ["", "## Switch it on", ""]
    lines += [f"{n}. {step}" for n, step in enumerate(target.activation, 1)]
    lines += ["", "## Three-point check", ""]
    if moves := _moves(read):
        lines += [
            "Go there from below, then from above, other axes at mid travel; expect this correction.",
            _state(table),
        ]
        lines += ["", "| axis | over | position | from below, um | from above, um |", "| --- | --- | --- | --- | --- |"]
        lines += moves
    else:
        lines += ["Nothing of this table acts over a position or per kelvin: compare the outputs in two known states."]
    lines += ["", "## What this format leaves behind", ""]
    lines += [
        f"- {x['axis']}: {x['rms_um']:.3g} um rms of {x['table_rms_um']:.3g}, largest seen {x['largest_um']:.3g} um"
        for x in lost
    ]
    if lost:
        seen = lost[0]["states"]
        lines += ["", f"Seen on {seen} random settled states inside validity and at its ends; not a bound."]
    return "\n".join([*lines, ""])


def _at_the_axis(table: CompensationTable) -> list[str]:
    """How a component that has no axis of its own, such as a diameter, moves the axis that corrects it."""
    from errpipe.domain import components

    says = []
    for output in table.outputs:
        for term in output.terms:
            try:
                parsed = components.parse(term.component)
            except ValueError:
                continue
            if output.axis and parsed.kind in ("diameter", "circular") and not term.factors:
                along, less = 10.0 * term.weight, "less" if term.weight > 0 else "more"
                says.append(
                    f"a {components.describe(parsed.name)} of +10 um stands for {along:+g} um along {output.axis}, so "
                    f"{output.axis} is told to go {abs(along):g} um {less} (factor {term.weight:g}, from acts_on of "
                    "the export; turn one piece before trusting its sign)"
                )
    return says


def _within_travel(read: Any, table: CompensationTable) -> Any:
    """What was read back, its curves cut at the ends of travel: a file's grid may reach further than the axis."""
    from dataclasses import replace

    import numpy as np

    from errpipe.targets import _sample

    curves = []
    for c in read.curves:
        low, high = _sample.reach(table, c.over)
        inside = c.positions[(c.positions > low) & (c.positions < high)]
        x = np.concatenate(([low], inside, [high])) if high > low else c.positions
        up, down = (np.interp(x, c.positions, v) for v in (c.up, c.down))
        curves.append(replace(c, positions=x, up=up, down=down))
    return replace(read, curves=tuple(curves))


def _state(table: CompensationTable) -> str:
    """The readings at which the expected corrections hold."""
    from errpipe.targets import _sample

    start, moving = _sample.middle(table), set(_sample.positions_of(table).values())
    still = [f"{i.name} = {start[i.name]:g} {i.unit}".rstrip() for i in table.inputs if i.name in set(start) - moving]
    if not still:
        return "Nothing else matters to it: no temperature, no speed."
    return f"It holds at {', '.join(still)}, all of them steady; at other readings expect other values."


def _moves(read: Any) -> list[str]:
    """Rows of the move list: three points of each curve, the corners of each product, one kelvin of each sensor."""
    import numpy as np

    ends = {c.over: (float(c.positions[0]), float(c.positions[-1])) for c in read.curves}
    for part in (*read.products, *read.planes):
        grids = getattr(part, "positions", None) or (part.first, part.second)
        ends |= {over: (float(x[0]), float(x[-1])) for over, x in zip(part.over, grids, strict=True)}
    middle = {over: np.full(1, (low + high) / 2) for over, (low, high) in ends.items()}
    cold = {line.sensor: np.full(1, line.reference) for line in read.lines}

    def row(axis: str, over: str, where: str, at: dict[str, float]) -> str:
        there = middle | {name: np.full(1, x) for name, x in at.items()}
        up, down = (1e3 * float(read.correction(axis, there, np.full(1, s), cold)[0]) for s in (1.0, -1.0))
        return f"| {axis} | {over} | {where} | {up + 0.0:+.2f} | {down + 0.0:+.2f} |"

    lines = []
    for axis, over in dict.fromkeys((c.axis, c.over) for c in read.curves):
        lines += [row(axis, over, f"{x:.3f}", {over: float(x)}) for x in np.linspace(*ends[over], 3)]
    for axis, (a, b) in dict.fromkeys((p.axis, p.over) for p in (*read.products, *read.planes)):
        corners = [(x, y) for x in ends[a] for y in ends[b]]
        lines += [row(axis, f"{a} and {b}", f"{x:.3f}, {y:.3f}", {a: x, b: y}) for x, y in corners]
    for line in read.lines:
        per_kelvin = 1e3 * line.level
        lines.append(f"| {line.axis} | {line.sensor} +1 K | {line.zero:.3f} | {per_kelvin:+.3f} | {per_kelvin:+.3f} |")
    return lines


def _line(row: dict[str, Any]) -> str:
    if "refused" in row:
        return f"{row['target']:<22} -  {row['refused']}"
    loss = f"loses {row['rms_um']:.3g} of {row['table_rms_um']:.3g} um rms, {row['largest_um']:.3g} largest seen"
    return f"{row['target']:<22} {row['axis']}  {loss}"
