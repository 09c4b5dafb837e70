"""Controller files: written, read back as the controller would, compared with the table, with a checklist."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import combinations
from pathlib import Path
from typing import Any

from errpipe import jsonfile
from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError, UsageError, did_you_mean
from errpipe.files import inside
from errpipe.registry import minisign, signed
from errpipe.stages import _artefacts, _plausible
from errpipe.stages._checklist import checklist, consequences
from errpipe.stages._replace import replaced
from errpipe.tables.joined import joined
from errpipe.targets import TARGETS, _loss
from errpipe.targets._base import ANOTHER_FORMAT, Curve, NothingToAddError, ReadBack
from errpipe.targets._loss import at_most, loss_unit
from errpipe.targets._whole import WholeTable

CHECKLIST = "CHECKLIST.md"
LARGE_SHARE, LARGE_UM = 0.1, 0.5  # of the table's rms and um: a loss worth another format, a constant worth naming
TURNS_THE_PART = (
    "a part comes out worse once its pose is set: {0}; they correct in part, which turns it: " + ANOTHER_FORMAT
)
DIGITS = 6  # of a loss in um: what lies below is rounding, which differs between machines and would fail `verify`


def targets() -> dict[str, Any]:
    """All formats with their controller, confidence, sign and limits."""
    facts = ("name", "controller", "confidence", "sign", "limits")
    rows = [{**{fact: getattr(t, fact) for fact in facts}, "goes_with": list(t.goes_with)} for t in TARGETS]
    return {"targets": rows, "says": [_described(row) for row in rows]}


def _described(row: dict[str, Any]) -> str:
    line = f"{row['name']:<22} {row['confidence']:<13} {row['controller']}\n    {row['sign']}; {row['limits']}"
    return line + (f"\n    goes with {', '.join(row['goes_with'])}" if row["goes_with"] else "")


def compare_targets(table: Path) -> dict[str, Any]:
    """What each controller would lose of a table, in micrometres, on settled states inside validity."""
    compensation_table = _artefacts.read_table(table)
    rows: list[dict[str, Any]] = []
    for target in TARGETS:
        try:
            lost = losses(compensation_table, target, target.write(compensation_table))
        except GateError as err:
            rows.append({"target": target.name, "refused": str(err)})
            continue
        rows += [{"target": target.name, **loss} for loss in lost]
    rows += [
        {"target": " + ".join(names), **loss} for names, lost in _best_combinations(compensation_table) for loss in lost
    ]
    return {"comparison": rows, "says": [_loss_line(row) for row in rows]}


def target_combinations(targets: Iterable[Any]) -> list[tuple[Any, ...]]:
    """Every combination of two or more targets that one controller adds up."""

    targets = tuple(targets)
    max_targets = max((len(t.goes_with) for t in targets), default=0) + 1
    choices = [c for size in range(2, max_targets + 1) for c in combinations(targets, size)]
    return [c for c in choices if all((b.name in a.goes_with or a.name in b.goes_with) for a, b in combinations(c, 2))]


def write_together(table: CompensationTable, parts: Sequence[Any]) -> tuple[list[dict[str, str]], Any]:
    """Files of each part, without duplicated content, and all as the controller reads them. Raises GateError."""
    files = [part.write_with(table, [o.name for o in parts if o is not part]) for part in parts]
    first, *rest = (part.read_back(own) for part, own in zip(parts, files, strict=True))
    return files, sum(rest, start=first)


def refuse_incompatible(parts: Sequence[Any], option: str) -> None:
    """Raise UsageError for targets whose files no controller adds up."""
    for a, b in combinations(parts, 2):
        if b.name not in a.goes_with and a.name not in b.goes_with:
            raise UsageError(f"{option}: no controller adds the files of {a.name} and {b.name} (errpipe targets)")


def files_in_effect(table: CompensationTable, parts: Sequence[Any], *, entered: bool) -> Any:
    """What a controller adds that has the files of these targets. entered: and the numbers of their checklists."""
    kept, _, _ = _without_harm(table, parts)
    files, read = write_together(kept, parts)
    if isinstance(read, WholeTable) or not entered:
        return read
    return read + ReadBack(curves=_entered_by_hand(kept, parts, files))


def _best_combinations(table: CompensationTable) -> list[tuple[tuple[str, ...], list[dict[str, Any]]]]:
    """For each family of formats, the choice that loses least (root of summed squares over the axes)."""
    best: dict[str, tuple[float, tuple[str, ...], list[dict[str, Any]]]] = {}
    for parts, lost in _combined_losses(table, target_combinations(TARGETS)):
        size, names = _sum_of_squares(lost), tuple(p.name for p in parts)
        family = min((names[0], *parts[0].goes_with))
        if family not in best or size < best[family][0]:
            best[family] = (size, names, lost)
    return [(names, lost) for _, names, lost in best.values()]


def _combined_losses(
    table: CompensationTable, choices: Iterable[tuple[Any, ...]]
) -> Iterator[tuple[tuple[Any, ...], list[dict[str, Any]]]]:
    """What each choice of formats loses of a table together; without those that refuse it."""
    for parts in choices:
        with suppress(GateError):
            yield parts, _loss_rows(table, write_together(table, parts)[1])


def _sum_of_squares(lost: Iterable[dict[str, Any]]) -> float:
    """Sum over the axes of squared rms losses, um2."""
    return sum(x["rms_um"] ** 2 for x in lost)


def export(
    table: Path | Sequence[Path],
    names: Sequence[str],
    out: Path,
    allow: Sequence[str] = (),
    limit: float | None = None,
    public_key: Path | None = None,
) -> dict[str, Any]:
    """The files of named targets, with a copy of their table, in a folder that `verify` reads.

    table: tables of several axes are exported as one. allow, limit: as the options of the export stage (limit in um).
    public_key: the table must be signed by it, and its signature is copied. Controllers' files of an export before it
    go, where this one has none of that name. Raises GateError for an implausible correction, VerifyError where it is
    not signed, UsageError where tables do not join.
    """
    files = [table] if isinstance(table, Path) else list(table)
    if public_key and len(files) > 1:
        raise UsageError(
            "--public-key: several tables become one, which is unsigned (export them, then `errpipe sign`)"
        )
    compensation_table, remarks, signature = (
        _signed(files[0], public_key) if public_key else (joined([_artefacts.read_table(f) for f in files]), (), "")
    )
    _plausible.refuse_table(compensation_table, allow, limit)
    with replaced(Path(out)) as folder:
        rows = write_targets(compensation_table, names, folder, remarks)
        _artefacts.write_table(folder, compensation_table)
        signed_too = [f"{_artefacts.TABLE}.minisig"] if signature else []
        for name in signed_too:
            jsonfile.write_text(folder / name, signature)
        document = {"export": 1, "inputs": compensation_table.fingerprint, "proof": [], "files": rows, "left_out": []}
        document["consequences"] = _plausible.of_table(compensation_table)
        document["sha256"] = checksums(folder, rows, [_artefacts.TABLE, _artefacts.TWIN, *signed_too])
        jsonfile.write(folder / "export.json", document)
    worse = dict.fromkeys(sentence for r in rows for sentence in r.get("worse", ()))
    happens = dict.fromkeys(f"{r['file'].split('/')[0]}: {sentence}" for r in rows for sentence in r["consequences"])
    says = [*(f"{Path(out) / r['file']}: {r['what']}, lost: {r['error']}" for r in rows), *worse, *happens]
    return {"files": rows, "says": says}


def _signed(table: Path, public_key: Path) -> tuple[CompensationTable, tuple[str, ...], str]:
    """A table with a valid signature, the remarks for its files, the signature."""
    key, signature = minisign.read_public(public_key), minisign.signature_of(table)
    compensation_table = signed.read_table(table, key)
    return compensation_table, signed.remarks(compensation_table, signature, key), signature


def checksums(folder: Path, files: Iterable[dict[str, Any]], others: Iterable[str] = ()) -> dict[str, str]:
    """SHA-256 of every exported file by its path in the folder, with the checklists of the targets."""
    names = {row["file"] for row in files} | set(others)
    names |= {f"{name.split('/')[0]}/{CHECKLIST}" for name in names if "/" in name}
    return {name: hashlib.sha256(inside(folder, name, GateError).read_bytes()).hexdigest() for name in sorted(names)}


def write_targets(
    table: CompensationTable,
    names: Sequence[str],
    folder: Path,
    remarks: Sequence[str] = (),
    note: str = "",
    motion: _loss.Motion | None = None,
) -> list[dict[str, Any]]:
    """Write the files of each named target to a separate folder. Raises UsageError for an unknown name.

    remarks: comment lines, such as the table's signature, behind the warnings in the table's title; written where a
    format has room for comments.
    note: a sentence for every checklist. motion: of the machine's linear axes; left out: along X, Y, Z.
    """
    out = []
    targets = with_own_content(table, chosen(list(dict.fromkeys(names))))
    remarks = (*_artefacts.warnings_in(table.title), *remarks)
    for target in targets:
        others = _sibling_names(target, targets)
        kept, files, worse = _without_harm(table, [target, *chosen(others)], motion)
        files = target.with_remarks(files, remarks)
        read, lost = target.read_back(files), losses(table, target, files)
        for name, text in files.items():
            jsonfile.write_text(inside(folder, f"{target.name}/{name}", GateError), text)
        happens = consequences(read, kept)
        steps = checklist(target, read, lost, kept, others)
        hint = _with_companions(kept, target, others) if others else better_formats(table, target, lost)
        steps += "".join(f"\n{sentence}\n" for sentence in (*(f"**{x}.**" for x in worse), hint, note) if sentence)
        jsonfile.write_text(folder / target.name / CHECKLIST, steps)
        out += [
            {
                "file": f"{target.name}/{name}",
                "what": target.controller,
                "error": in_words(lost),
                "read_back": "compared",
                "losses": lost,
                "consequences": happens,
                **({"sibling": hint} if hint else {}),
                **({"worse": worse} if worse else {}),
            }
            for name in files
        ]
    return out


def _without_harm(
    table: CompensationTable, parts: Sequence[Any], motion: _loss.Motion | None = None
) -> tuple[CompensationTable, dict[str, str], list[str]]:
    """The table without axes that the files of these targets together leave worse off, files of the first, remarks.

    Raises GateError where the format has nothing left.
    """
    files, read = write_together(table, parts)
    if isinstance(read, WholeTable):
        return table, files[0], []
    read += ReadBack(curves=_entered_by_hand(table, parts, files))
    harmed, names = _loss.harmed(table, read), " and ".join(sorted(p.name for p in parts))
    if not harmed:
        said, turning = _loss.worse_than_none(table, read), _loss.turning(table, read, motion)
        turned = (f"{a} {left:.3g} um rms instead of {round(without, 3):.3g}" for a, (left, without) in turning.items())
        said += [TURNS_THE_PART.format(", ".join(turned))] if turning else []
        return table, files[0], [f"{names}: {sentence}" for sentence in said]
    figures = (f"{a} {left:.3g} {loss_unit(a)} rms instead of {without:.3g}" for a, (left, without) in harmed.items())
    sentence = f"{names}: worse with these files than without: {', '.join(figures)}"
    kept = table.model_copy(update={"outputs": tuple(o for o in table.outputs if o.axis not in harmed)})
    try:
        kept, first, more = _without_harm(kept, parts, motion)
    except GateError:
        raise GateError(f"{sentence}: {ANOTHER_FORMAT}") from None
    return kept, first, [f"{sentence}; left out of them. To correct it, {ANOTHER_FORMAT}", *more]


def _entered_by_hand(
    table: CompensationTable, parts: Sequence[Any], files: Sequence[dict[str, str]]
) -> tuple[Curve, ...]:
    """What numbers entered by hand add to the files of parts that are loaded together."""
    return tuple(
        number.curve
        for part, own in zip(parts, files, strict=True)
        for number in part.by_hand(table, part.read_back(own), [o.name for o in parts if o is not part])
        if number.curve is not None
    )


def better_formats(table: CompensationTable, target: Any, lost: list[dict[str, Any]]) -> str:
    """Which formats of the same controller express what this one loses, in a sentence; "" where that is little."""
    worst = max(lost, key=lambda x: x["rms_um"] / max(x["table_rms_um"], 1e-9), default=None)
    if worst is None or worst["rms_um"] < max(LARGE_SHARE * worst["table_rms_um"], LARGE_UM):
        return ""
    best: tuple[float, str, str] | None = None
    for parts, lost_together in _combined_losses(table, (c for c in target_combinations(TARGETS) if target in c)):
        size = _sum_of_squares(lost_together)
        if best is None or size < 0.9 * best[0]:
            best = size, ", ".join(o.name for o in parts if o is not target), in_words(lost_together)
    if best is None or best[0] >= 0.25 * _sum_of_squares(lost):  # not even half of it
        return ""
    return f"{best[1]} can express what {target.name} cannot; with both as targets the loss is {best[2]}."


def with_own_content(table: CompensationTable, targets: Sequence[Any]) -> list[Any]:
    """The targets without those that add nothing to their companions."""
    kept = list(targets)
    for target in targets:
        try:
            target.write_with(table, _sibling_names(target, kept))
        except NothingToAddError:
            kept.remove(target)
    return kept


def _with_companions(table: CompensationTable, target: Any, others: Sequence[str]) -> str:
    """Which files must be loaded in addition, and the residual of all once the numbers are entered."""
    parts = [target, *chosen(others)]
    files, read = write_together(table, parts)
    entered = _entered_by_hand(table, parts, files)
    numbers = "Together, with the numbers entered by hand," if entered else "Together"
    return (
        f"Load the files of {target.name} only together with those of {', '.join(others)}, whose part they leave out. "
        f"{numbers} they lack {in_words(_loss_rows(table, read + ReadBack(curves=entered)))}."
    )


def _sibling_names(target: Any, targets: Sequence[Any]) -> list[str]:
    """Names of the other targets of an export that go with one."""
    return [o.name for o in targets if o is not target and (o.name in target.goes_with or target.name in o.goes_with)]


def chosen(names: Sequence[str]) -> list[Any]:
    """Targets by name. Raises UsageError with the nearest name."""
    for name in (n for n in names if n not in TARGETS.tags):
        raise UsageError(f"no target {name!r} (targets: {', '.join(TARGETS.tags)}).{did_you_mean(name, TARGETS.tags)}")
    return [TARGETS[name] for name in names]


def _loss_rows(table: CompensationTable, read: Any) -> list[dict[str, Any]]:
    """Losses per axis: a bound over all settled states inside validity; rms and the largest on random ones."""
    return [
        {
            "axis": x.axis,
            "bound_um": math.ceil(x.bound * 10**DIGITS) / 10**DIGITS,
            "largest_um": round(x.largest, DIGITS),
            "rms_um": round(x.rms, DIGITS),
            "table_rms_um": round(x.table_rms, DIGITS),
            "constant_um": round(x.constant, DIGITS),
            "assessed": x.table_rms > 0.0 or isinstance(read, WholeTable),
            "states": _loss.STATES,
        }
        for x in _loss.losses(table, read)
    ]


def losses(table: CompensationTable, target: Any, files: dict[str, str]) -> list[dict[str, Any]]:
    """What a target's files lose of a table, per axis in um, as `export.json` keeps it."""
    return _loss_rows(table, target.read_back(files))


def in_words(lost: list[dict[str, Any]]) -> str:
    if not lost:
        return "nothing: no axis is moved"
    units = [loss_unit(x["axis"]) if x["assessed"] else "" for x in lost]
    last = [unit if following != unit else "" for unit, following in zip(units, [*units[1:], ""], strict=True)]
    figures = (f"{x['rms_um']:.3g} rms, at most {at_most(x['bound_um'])}" for x in lost)
    rows = [f"{x['axis']} {text if x['assessed'] else 'not assessed'}" for x, text in zip(lost, figures, strict=True)]
    words = "; ".join(f"{row} {unit}".rstrip() for row, unit in zip(rows, last, strict=True))
    zeros = ", ".join(f"{x['axis']} {x['constant_um']:+.3g} um" for x in lost if abs(x["constant_um"]) > LARGE_UM)
    return words + (f" (besides constants, which setting the zero removes: {zeros})" if zeros else "")


def _loss_line(row: dict[str, Any]) -> str:
    if "refused" in row:
        return f"{row['target']:<22} -  {row['refused']}"
    unit = loss_unit(row["axis"])
    loss = f"loses {row['rms_um']:.3g} of {row['table_rms_um']:.3g} {unit} rms, at most {at_most(row['bound_um'])}"
    return f"{row['target']:<22} {row['axis']}  {loss}"
