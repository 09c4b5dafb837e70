"""Reports of a retraining, for people and for CI: Markdown for a pull request, JUnit XML, annotations, a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape  # xml.sax.saxutils, with the same, imports an HTTP client
from pathlib import Path
from typing import Any

import numpy as np

from errpipe import jsonfile
from errpipe.reporting.markup import plain_text, workflow_command
from errpipe.validation.retraining import EVIDENCE

MARKDOWN, JUNIT, GITLAB, FIGURE = "retrain.md", "retrain.junit.xml", "retrain.codequality.json", "retrain.svg"


def write_pages(document: Mapping[str, Any], out: Path) -> None:
    """Write every page of a retraining into its folder, whole."""
    jsonfile.write_text(out / MARKDOWN, markdown(document))
    jsonfile.write_text(out / JUNIT, junit(document))
    jsonfile.write(out / GITLAB, code_quality(document))
    if document["runs"]:
        jsonfile.write_text(out / FIGURE, figure(document))


def write_failure(title: str, why: str, out: Path) -> None:
    """Write the pages of a failed retraining, replacing those of the previous one.

    On a full disk no page is left: CI would take those of the previous one as current.
    """
    for page in (MARKDOWN, JUNIT, GITLAB, FIGURE):
        (out / page).unlink(missing_ok=True)
    title = title or "Retraining"
    case = f'  <testcase classname="{escape(title)}" name="judged"><error message="{escape(why)}"/></testcase>'
    text = f"# {plain_text(title)}: not judged\n\n{plain_text(why)}\n\nThe champion is kept.\n"
    jsonfile.write_text(out / MARKDOWN, text)
    jsonfile.write_text(out / JUNIT, _test_suite({"tests": 1, "failures": 0, "errors": 1, "skipped": 0}, [case]))
    jsonfile.write(out / GITLAB, [_quality(title, "not judged", why, "blocker")])


def markdown(document: Mapping[str, Any]) -> str:
    """The page for a pull request."""
    promoted = document["decision"] == "promote"
    lines = [
        f"# {plain_text(document['title'])}: {document['decision']}",
        "",
        f"Evidence for the challenger: e-value {document['e_value']:.3g}, {document['e_value_needed']:.3g} needed. "
        + ("Every gate holds." if promoted else "What failed is listed first."),
        f"A challenger that is no better reaches {document['e_value_needed']:.3g} in at most"
        f" {1.0 / document['e_value_needed']:.2g} of all histories, however often one looks.",
        *map(plain_text, _fitted(document)),
        "",
        f"**Next:** {_next_step(document)}",
        "",
        "| gate | holds | why |",
        "| --- | --- | --- |",
    ]
    ordered = sorted(document["gates"], key=lambda g: g["passed"])
    lines += [
        f"| {plain_text(g['name'])} | {'yes' if g['passed'] else '**no**'} | {plain_text(g['says'])} |" for g in ordered
    ]
    lines += ["", *_drift_lines(document["drift"])]
    return "\n".join(lines).rstrip() + "\n"


def _next_step(document: Mapping[str, Any]) -> str:
    if document["decision"] == "promote":
        return "put `run` beside this page in the place of the champion's folder, and its table on the machine."
    if all(g["passed"] or _pending(g) for g in document["gates"]):
        return "nothing. The champion stays; further runs add evidence."
    return "the champion stays. Correct each item marked **no**, or allow it if it is intended, and run this again."


def _fitted(document: Mapping[str, Any]) -> list[str]:
    """The runs of the challenger's fit, if the machine changed at one of them; inputs with a narrower fitted range."""
    says = str(document["fitted_on_all"])
    if document["fitted_since"]:
        says = f"Fitted on the runs since {document['fitted_since']} alone: those before are another machine's."
    return [*([says] if says else []), *document["narrower"]]


def _regime(d: Mapping[str, Any]) -> str:
    return f", in runs of {d['regime']} alone" if d.get("regime") else ""


def _drift_lines(drift: Mapping[str, Any]) -> list[str]:
    lines = ["## Drift", ""]
    if not any(drift.values()):
        return [*lines, "Neither the sensors nor the champion's residual left what they were when it was fitted."]
    texts = [f"Sensor {d['column']} {_verdict(d)} since run {d['since']}: {d['size']:+.2g} K." for d in drift["inputs"]]
    texts += [
        f"The champion's residual of {d['component']} moved since run {d['since']}{_regime(d)}: "
        f"{d['size_um']:+.3g} um on average."
        for d in drift["residuals"]
    ]
    texts += [
        f"The champion leaves {d['after_um']:.3g} um rms of {d['component']} since run {d['since']}{_regime(d)}, "
        f"{d['before_um']:.3g} um before."
        for d in drift["rms"]
    ]
    wrong = [f", or {d['column']} reads wrong" for d in drift["inputs"] if d["flagged"]]
    texts += [
        f"{d['component']} is {d['factor']:.2g} times what the champion predicts since run {d['since']}: "
        f"{d['meaning'] or 'the machine changed' + ''.join(wrong)}."
        for d in drift["sizes"]
    ]
    return [*lines, *(f"- {plain_text(sentence)}" for sentence in (*texts, *_sentences(drift)))]


def _verdict(sensor: Mapping[str, Any]) -> str:
    if sensor["healthy"]:
        return (
            "left the others but reads right, as the deviations show (what surrounds it changed: coolant, place, load?)"
        )
    if sensor["flagged"]:
        return "drifts" if sensor["isolated"] else "may be the one that drifts"
    return "disagrees with the others"


def in_words(document: Mapping[str, Any]) -> list[str]:
    """Lines for a terminal: decision, failed gates, sensors that may drift, changes."""
    lines = [document["decision"], *(f"{g['name']}: {g['says']}" for g in document["gates"] if not g["passed"])]
    for d in (d for d in document["drift"]["inputs"] if d["flagged"] or d["healthy"]):
        lines.append(f"sensor {d['column']} {_verdict(d)} since run {d['since']}")
    return [*lines, *_fitted(document), *_sentences(document["drift"])]


def _sentences(drift: Mapping[str, Any]) -> list[str]:
    """One sentence per changed term of the model, per deviating sensor and per outlying run."""
    out = []
    for change in drift["changes"]:
        terms = "; ".join(t["says"] for t in change["terms"])
        out.append(f"What changed of {change['component']} since run {change['since']}: {terms}.")
    left = [d for d in drift["inputs"] if not d["healthy"]]
    if left and not any(d["flagged"] for d in left):
        out.append(
            f"{' and '.join(d['column'] for d in left)} left the others since run {left[0]['since']}: whether one"
            " of them is wrong or what surrounds it changed, a further sensor or a thermometer beside it shows."
        )
    out += [f"Run {outlier['run']}, {outlier['what']}: {outlier['says']}" for outlier in drift["runs"]]
    return out


def junit(document: Mapping[str, Any]) -> str:
    """One test case per gate, as CI systems read them; insufficient evidence is skipped, not failed."""
    gates = document["gates"]
    waiting, lines = sum(_pending(g) for g in gates), []
    failed = sum(not g["passed"] for g in gates) - waiting
    for gate in gates:
        name, says, kind = escape(gate["name"]), escape(gate["says"]), "skipped" if _pending(gate) else "failure"
        lines.append(f'  <testcase classname="{escape(document["title"])}" name="{name}">')
        lines += [] if gate["passed"] else [f'    <{kind} message="{says}">{says}</{kind}>']
        lines.append("  </testcase>")
    return _test_suite({"tests": len(gates), "failures": failed, "errors": 0, "skipped": waiting}, lines)


def _test_suite(counts: Mapping[str, int], cases: Sequence[str]) -> str:
    """JUnit XML of test cases."""
    attributes = "".join(f' {name}="{count}"' for name, count in counts.items())
    head = f'<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="errpipe retrain"{attributes}>'
    return "\n".join([head, *cases, "</testsuite>", ""])


def _pending(gate: Mapping[str, Any]) -> bool:
    """Whether a gate fails only for lack of further runs."""
    return not gate["passed"] and gate["name"] == EVIDENCE


def code_quality(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Failed gates as GitLab's code quality report."""
    failed = [g for g in document["gates"] if not g["passed"]]
    return [_quality(document["title"], g["name"], g["says"], "info" if _pending(g) else "major") for g in failed]


def _quality(title: str, name: str, says: str, severity: str) -> dict[str, Any]:
    return {
        "description": f"{title}, {name}: {says}",
        "check_name": "errpipe retrain",
        "fingerprint": jsonfile.fingerprint([title, name, says])[:32],  # findings of one fingerprint are one to GitLab
        "severity": severity,
        "location": {"path": MARKDOWN, "lines": {"begin": 1}},
    }


def github_annotations(document: Mapping[str, Any]) -> list[str]:
    """Workflow commands, a line for each failed gate and all that drifted."""
    failed = [g for g in document["gates"] if not g["passed"]]
    warnings = [("sensor", f"{d['column']} {_verdict(d)} since run {d['since']}") for d in document["drift"]["inputs"]]
    warnings += [("narrower validity", says) for says in document["narrower"]]
    warnings += [("drift", sentence) for sentence in _sentences(document["drift"])]
    return [
        *(workflow_command("notice" if _pending(g) else "error", g["says"], title=g["name"]) for g in failed),
        *(workflow_command("warning", says, title=title) for title, says in warnings),
    ]


def figure(document: Mapping[str, Any]) -> str:
    """rms per new run: uncompensated, champion, challenger."""
    from errpipe.reporting import svg

    runs = document["runs"]
    at = np.arange(len(runs))
    with svg.figure(7.2, 3.0) as (canvas, axes):
        for name, colour, label in (
            ("nothing", svg.BEFORE, "uncompensated"),
            ("champion", svg.FLOOR, "champion"),
            ("challenger", svg.AFTER, "challenger, fitted before the run"),
        ):
            axes.plot(at, np.sqrt([r[name] for r in runs]), "o-", color=colour, label=label, markersize=3)
        axes.set_xlabel("new run")
        axes.set_ylabel("rms, um")
        axes.set_ylim(bottom=0)
        axes.legend(fontsize=8)
        return svg.to_svg(canvas, "Residual of each new run")
