"""Several files of one layout as one recording: the runs of a test, the days of a logger."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.domain import units
from errpipe.errors import DataError
from errpipe.importing.columns import side
from errpipe.importing.order import set_side
from errpipe.importing.proposed import AXIS_ASSUMED, Proposal
from errpipe.importing.words import BEFORE_A_STATE, plain

OF_A_MACHINE = ("command", "position", "actual")
MAX_SHEETS_NAMED = 6  # sheets named in a message


def concatenate_files(parts: Sequence[Proposal], stems: Sequence[str]) -> Proposal:
    """Concatenate files of one layout; the runs of each carry its name, and times count from the first date."""
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    gaps = _without_sensor(parts, stems)
    _refuse_another_sign(parts, stems)
    for other, stem in zip(parts[1:], stems[1:], strict=True):
        if other.entries.keys() != first.entries.keys():
            not_shared = ", ".join(sorted(other.entries.keys() ^ first.entries.keys()))
            advice = "give a quantity one header in all files; where its sign is the other one, reverse its values, too"
            raise DataError(f"{stem}: its columns are not those of {stems[0]} (not in both: {not_shared}): {advice}")
        shift(other, epoch_of(first), epoch_of(other))
        for name, entry in first.entries.items():
            _refuse_another(name, (entry, other.entries[name]), (stems[0], stem))
    _in_one_unit(parts, stems)
    joined = Proposal(entries=dict(first.entries), guesses=dict(first.guesses), notes=[*first.notes, *gaps])
    for part, stem in zip(parts[1:], stems[1:], strict=True):
        joined.notes += [f"{stem}: {note}" for note in part.notes if note not in (*first.notes, AXIS_ASSUMED)]
    run = joined.first("run")
    if run is None:
        run = joined.put("run", None, "one run for each file", role="run")
        joined.entries = {run: joined.entries.pop(run), **joined.entries}
    for name in first.data:
        values = [part.data[name] for part in parts]
        joined.data[name] = (
            [v for part in values for v in part] if isinstance(values[0], list) else np.concatenate(values)
        )
    labels = []
    for part, stem in zip(parts, stems, strict=True):
        own_labels = part.data.get(run)
        labels += [f"{stem}-{label}" for label in own_labels] if own_labels is not None else [stem] * part.rows
    joined.data[run] = labels
    return joined


def _without_sensor(parts: Sequence[Proposal], stems: Sequence[str]) -> list[str]:
    """Fill temperatures that some files lack, or have without a reading, with empty cells, in place; notes on them."""
    notes = []
    whole = max(parts, key=lambda part: len(part.entries))
    for part, stem in zip(parts, stems, strict=True):
        missing = lacking(whole, part) or []
        for name in missing:
            part.entries[name] = dict(whole.entries[name])
            part.guesses[name] = whole.guesses.get(name, "")
            part.data[name] = np.full(part.rows, np.nan)
        if missing:
            notes.append(f"{stem}: no reading of {', '.join(missing)}: missing")
    return notes


def names_of_files(files: Sequence[Path], inside: Mapping[Path, tuple[str, ...]]) -> list[str]:
    """Names of runs, one per file: the stem, after the folders that not all of them share; a number if two are equal.

    inside: the folders of a file within a folder or archive from the user; of any other file its own folder counts.
    """
    parts = [(*inside.get(file, (file.resolve().parent.name,)), file.stem) for file in files]
    shared = next(
        (n for n, of in enumerate(zip(*parts, strict=False)) if len({*of}) > 1), len(parts[0]) if parts else 0
    )
    stems = ["_".join(part[min(shared, len(part) - 1) :]) for part in parts]
    return [f"{s}_{stems[: n + 1].count(s)}" if stems.count(s) > 1 else s for n, s in enumerate(stems)]


def lacking(whole: Proposal, part: Proposal) -> list[str] | None:
    """Temperatures of the first that the second lacks; None if it differs in more: another name is another sensor."""
    missing = [n for n in whole.entries if n not in part.entries]
    other = part.entries.keys() - whole.entries.keys() or any(
        whole.entries[n]["role"] != "temperature" for n in missing
    )
    return None if other else missing


_SIDE_OF_NAME = re.compile(r"[^\W\d_]{2,}|(?<=[^\W_])[+-](?![^\W_])|(?<![^\W_])[+-](?=[XYZABC](?:_|\b))")  # `X+`, `-X`
_RUN_WORD = r"(?:runs?|lauf|durchlauf|messung|messreihe|cycle|zyklus|pass|trial|essai|passe|prova|ensayo|pasada)"


def are_runs(names: Sequence[str]) -> bool:
    """Whether names of sheets are those of the runs of one test: `Run 1`, `Run 2`, or `Forward`, `Backward`.

    Names that differ in more than a run number and a side, or have neither, may be of other machines or states.
    """
    rests = {re.sub(rf"{_RUN_WORD}[ _.-]*\d+", "", plain(name)) for name in names}
    bare = {re.sub(r"[^\W\d_]{2,}", lambda m: "" if side(m[0]) is not None else m[0], rest).strip() for rest in rests}
    numbered = all(re.search(rf"{_RUN_WORD}[ _.-]*\d+", plain(name)) for name in names)
    both = {side(w) for n in names for w in re.findall(r"[^\W\d_]{2,}", plain(n))} >= {1.0, -1.0}
    return len(bare) == 1 and len(set(names)) == len(names) and (numbered or both)


_CORRECTED = rf"(?:{BEFORE_A_STATE}[ -])?(?:comp(?:ens\w*)?|kompen[sz]\w*|korrektur|korrigiert|corre[cz]\w*)"
_STATES = re.compile(
    rf"(?<![^\W_])(before|after|vorher|nachher|avant|apres|{_CORRECTED}[ -]?(?:on|off|ein|aus)"
    rf"|un(?:comp|kompens|korr|corr)\w*|{_CORRECTED})(?![^\W_])"
)


def refuse_states(names: Sequence[str], what: str, answer: str) -> None:
    """Raise DataError if names state several states of one machine, such as before and after a compensation."""
    of_names = [tuple(m[0] for m in _STATES.finditer(plain(name))) for name in names]
    if len(set(of_names)) > 1:
        raise DataError(
            f"{what} {', '.join(names)}: several states of the machine? Runs of one test share one state: {answer} "
            "(if the state is the same, rename them)"
        )


def of_one_test(part: Proposal, first: Proposal) -> bool:
    """Whether two parts have columns of the same names, roles, axes and components."""
    keys = ("role", "axis", "component", "of", "derived")
    return part.entries.keys() == first.entries.keys() and all(
        [part.entries[n].get(k) for k in keys] == [e.get(k) for k in keys] for n, e in first.entries.items()
    )


def runs_of_sheets(sheets: list[tuple[Proposal, str]]) -> list[tuple[Proposal, str]]:
    """Sheets with their names; those that are runs of one test, by names and columns, merged.

    Raises DataError if columns are equal and the names are not those of runs: two years, or a corrected copy.
    """
    named = [sheet for sheet in sheets if are_runs([sheets[0][1], sheet[1]]) or sheet is sheets[0]]
    _refuse_another_sign([part for part, _ in named], [name for _, name in named])
    alike = [(part, name) for part, name in sheets if of_one_test(part, sheets[0][0])]
    parts, names = [part for part, _ in alike], [name for _, name in alike]
    if len(parts) < 2:
        return sheets
    if not are_runs(names):
        shown = ", ".join(names[:MAX_SHEETS_NAMED])
        raise DataError(
            f"sheets {shown} have the same columns: which one is meant? Select it with --sheet (runs of one test: name "
            "them Run 1, Run 2)"
        )
    joined = concatenate_files(parts, sides_of_names(parts, names))
    joined.notes.append(f"the sheets {', '.join(names)} are runs of one test")
    return [(joined, ", ".join(names)), *(rest for rest in sheets if rest[1] not in names)]


def sides_of_names(parts: Sequence[Proposal], stems: Sequence[str]) -> list[str]:
    """Run names of files that differ only by their sides, whose rows get these: `X_up`, `X_down`.

    The file names if their columns state the sides, or if not every name does.
    """
    of_names = [[w for w in _SIDE_OF_NAME.findall(stem) if side(w) is not None] for stem in stems]
    shared = set(of_names[0]).intersection(*of_names) if of_names else set()  # `pos` of `pos_X_up` and `pos_X_down`
    of_names = [[w for w in of_stem if w not in shared] for of_stem in of_names]
    ways = {side(words[0]) for words in of_names if len(words) == 1}
    stated = any(part.first("direction") is not None for part in parts)
    if stated or ways != {1.0, -1.0} or any(len(words) != 1 for words in of_names):
        return [*stems]
    for part, stem, (word,) in zip(parts, stems, of_names, strict=True):
        axis = next((e["axis"] for e in part.entries.values() if e["role"] in OF_A_MACHINE), None)
        if axis is not None:
            set_side(part, axis, word, f"the name of the file {stem!r} states {word!r}")
            part.guesses[part.first("direction") or ""] = "from the names of the files"
    bare = [_without(stem, word) for stem, (word,) in zip(stems, of_names, strict=True)]
    return [text.strip(" _-") or "1" for text in bare]


def _without(stem: str, word: str) -> str:
    return re.sub(rf"[\W_]*({_SIDE_OF_NAME.pattern})", lambda m: "" if m[1] == word else m[0], stem)


def _refuse_another(name: str, entries: tuple[dict[str, Any], ...], stems: tuple[str, str]) -> None:
    """Raise DataError if a column of two files belongs to another axis or component: they are not runs of one test."""
    for key in ("role", "axis", "component", "of", "derived"):
        here, there = (entry.get(key) for entry in entries)
        if here != there:
            raise DataError(f"{stems[1]}: {key} of {name!r} is {there}, in {stems[0]} {here}: import them separately")


def _refuse_another_sign(parts: Sequence[Proposal], stems: Sequence[str]) -> None:
    """Raise DataError if some parts state that their deviations are commanded minus actual, and others do not."""
    for part, stem in zip(parts, stems, strict=True):
        for name in [n for n, e in part.entries.items() if e["role"] == "error" and e.get("derived", {}).get("of")]:
            others = [(o.entries.get(name, {}), s) for o, s in zip(parts, stems, strict=True)]
            silent = next((s for e, s in others if e.get("role") == "error" and "derived" not in e), None)
            if silent is not None:
                raise DataError(
                    f"{stem}: {name!r} is commanded minus actual ({part.guesses.get(name, '').split('; ')[-1]}), and "
                    f"{silent} does not say so: if it holds for all, use --sign commanded-minus-actual; else import "
                    "them separately"
                )


def _in_one_unit(parts: Sequence[Proposal], stems: Sequence[str]) -> None:
    """Convert columns in several units to the canonical one, in place.

    Raises DataError if one of the units was guessed.
    """
    for name, entry in parts[0].entries.items():
        if len({part.entries[name].get("unit") for part in parts}) < 2 or entry["role"] == "ignore":
            continue
        guessed = [s for s, part in zip(stems, parts, strict=True) if "no unit is stated" in part.guesses.get(name, "")]
        if guessed:
            raise DataError(
                f"{guessed[0]}: no unit is stated for {name!r}, and it seems to differ from that of the other files"
            )
        for part in parts:
            convert = units.conversion(entry["role"], part.entries[name].get("unit"))
            if convert is not None:
                part.data[name] = convert(part.data[name])
                part.entries[name]["unit"] = convert.unit
        parts[0].notes.append(
            f"{name}: converted to {parts[0].entries[name]['unit']}, because the files have several units"
        )


def epoch_of(p: Proposal) -> datetime | None:
    """The date at which the time of a proposal, in s, was 0."""
    entry = p.entries.get(p.first("time") or "", {})
    return datetime.fromisoformat(entry["epoch"]) if entry.get("epoch") and entry.get("unit") == "s" else None


def shift(p: Proposal, start: datetime | None, own: datetime | None) -> None:
    """Make the times of a proposal count from another date. Raises DataError if only one date has a time zone."""
    if start is None or own is None:
        return
    if (start.tzinfo is None) != (own.tzinfo is None):
        zoned, bare = (start, own) if start.tzinfo else (own, start)
        raise DataError(
            f"the times of one file have a time zone ({zoned.isoformat()}) and those of another do not "
            f"({bare.isoformat()}), which may differ by hours: write both with a time zone, or both without"
        )
    time = p.first("time") or ""
    p.data[time] = p.data[time] + (own - start).total_seconds()
    p.entries[time]["epoch"] = start.isoformat()
