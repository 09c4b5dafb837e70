"""Lookup of terms and formats, and of what a refusal means."""

from __future__ import annotations

from typing import Any

from errpipe import errors
from errpipe.errors import UsageError, did_you_mean

EXIT_CODES = {
    "0": "Everything asked for was done.",
    "1": "An internal error: a fault of errpipe. Please report it with the output of --debug.",
    "2": "The command line or a configuration file cannot be used; the message names file, line and column.",
    "3": "Measurements are rejected: the message names file and line, what was found and what is allowed.",
    "4": "A quality gate refused: not better than no compensation, implausible, beyond a limit. Nothing was exported.",
    "5": "`errpipe plan --exit-code`: stages would run.",
    "6": "A file on disk is not what it claims to be: damaged, edited, or not equal to its model.",
}
HEADINGS = {
    "ingest": "Read directly by a pipeline (ingest: {recording: FILE}):",
    "import": "Converted to a recording first (errpipe import FILE --out FOLDER):",
    "identify": "Tests of a machine as a whole (stage identify): imported if the file states its set-up, else written "
    "by hand:",
}


def terms(name: str) -> dict[str, Any]:
    """Every term with what it is, or the whole page of one."""
    from errpipe.stages._docstrings import sections
    from errpipe.terms import TERMS
    from errpipe.verbs import reference

    if name:
        return {"term": name, "says": [reference.entry("terms", name).rstrip()]}
    rows = [{"term": t.model_fields["term"].default, "about": sections(t.__doc__ or "")[0]} for t in TERMS]
    rows.sort(key=lambda row: str(row["term"]))
    width = max(len(str(row["term"])) for row in rows)
    return {"terms": rows, "says": [f"{row['term']:<{width}}  {row['about']}" for row in rows]}


def formats(name: str) -> dict[str, Any]:
    """Every format with a reader of its own, and every kind of file that `errpipe import` opens."""
    from errpipe.formats import FORMATS
    from errpipe.importing.other_tests import TESTS
    from errpipe.importing.readers import READERS
    from errpipe.verbs import reference

    if name:
        return {"format": name, "says": [reference.entry("formats", name).rstrip()]}
    rows = [{"format": f.name, "how": "ingest", "about": _first_line(f.__doc__)} for f in FORMATS]
    rows += [{"format": name, "how": "identify", "about": what} for name, _, what, _ in TESTS]
    rows += [{"format": d.name, "how": "import", "about": _first_line(d.__doc__)} for d in READERS]
    lines = []
    for how, heading in HEADINGS.items():
        lines += [heading, *(f"  {r['format']:<20} {r['about']}" for r in rows if r["how"] == how)]
    return {"formats": rows, "says": lines}


def _first_line(text: str | None) -> str:
    return " ".join((text or "").strip().split("\n")[0].split())


def explain(code: str) -> dict[str, Any]:
    """What a name in brackets, a kind of error or an exit code means. Raises UsageError with the nearest."""
    from errpipe.validation.codes import EXPLANATIONS

    kinds = {n: k for n, k in vars(errors).items() if isinstance(k, type) and issubclass(k, errors.ErrpipeError)}
    known = {**EXPLANATIONS, **EXIT_CODES}
    known |= {n: f"{(k.__doc__ or '').strip()} Exit code {k.exit_code}." for n, k in kinds.items()}
    if code not in known:
        raise UsageError(f"nothing is named {code!r} (allowed: {', '.join(known)}).{did_you_mean(code, known)}")
    lines = [f"{code}: {known[code]}"]
    if code in EXPLANATIONS:
        lines.append(f"If the declaration is correct: export: {{allow: [{code}]}}, or errpipe export --allow {code}")
    return {"code": code, "explanation": known[code], "says": lines}
