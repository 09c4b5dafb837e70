"""Every command that README, docs and examples print exists (verb, options, files, targets of make), and every link."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe.cli import _verbs
from errpipe.cli._names import VERBS

TOP = Path(__file__).parents[2]
PAGES = [
    TOP / "README.md",
    TOP / "CONTRIBUTING.md",
    *sorted(TOP.glob("docs/*.md")),
    *sorted(TOP.glob("examples/*/README.md")),
]
PROGRAMS = ("errpipe", "make", "pytest", "python")
WRITTEN = (
    "pipelines/resampled.yaml",
    "pipelines/mean-rise.yaml",
)  # by recipes of CONTRIBUTING.md, which test_contributing.py walks
MADE = re.compile(r"^([a-z-]+):.*## ", re.M)


def commands(text: str) -> list[str]:
    """Command lines in code spans and in indented or fenced blocks, comments left out."""
    blocks = re.findall(r"^```.*?\n(.*?)^```", text, re.M | re.S)
    rest = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", rest)]
    lines = [line.strip() for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    lines += [line.strip() for line in re.findall(r"^ {4,}(\S.*)$", rest, re.M)]
    found = [re.sub(r"^([A-Z_]+=\S+ )+", "", c.removeprefix("$ ")).partition(" #")[0].strip() for c in (*spans, *lines)]
    return sorted({c for c in found if c.split(" ")[0] in PROGRAMS and " " in c})


def wrong(command: str) -> str:
    """What of a command is not there; "" where all of it is."""
    words = shlex.split(command)
    if words[0] == "errpipe":
        return wrong_verb(words[1:])
    if words[0] == "make":
        known = MADE.findall((TOP / "Makefile").read_text(encoding="utf-8"))
        return next((f"no target {w}" for w in words[1:] if "=" not in w and w not in known), "")
    words = [w for w in words[1:] if w != "-s"]
    if words[:1] == ["-m"]:
        path = TOP / words[1].replace(".", "/")
        outside = not (TOP / words[1].split(".")[0]).is_dir()
        return "" if outside or path.with_suffix(".py").is_file() or path.is_dir() else f"no module {words[1]}"
    files = [w.partition("::")[0] for w in words if w.endswith(".py") or w.startswith("tests/") or ".py::" in w]
    return next((f"no file {f}" for f in files if not (TOP / f).exists()), "")


def wrong_verb(words: list[str]) -> str:
    if words[0].startswith("-") or words[0] == "VERB":
        return ""
    if words[0] not in VERBS:
        return f"no verb {words[0]}"
    command: Any = _verbs.verb(words[0])
    options = {name: p for p in command.params for name in (*p.opts, *p.secondary_opts) if name.startswith("-")}
    unknown = [
        w for w in words[1:] if re.match(r"--?[a-z]", w) and w.partition("=")[0] not in {*options, "-h", "--help"}
    ]
    if unknown:
        return f"{words[0]} has no option {unknown[0]}"
    for word in words[1:]:
        if word.startswith(("pipelines/", "examples/")) and word not in WRITTEN and not (TOP / word).exists():
            return f"no file {word}"
    return ""


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(TOP)))
def test_every_command_of_the_page_exists(page: Path) -> None:
    assert [f"{c}: {w}" for c in commands(page.read_text(encoding="utf-8")) if (w := wrong(c))] == []


@pytest.mark.parametrize(
    "command",
    [
        "errpipe runn x",
        "errpipe run x --oout y",
        "errpipe run pipelines/none.yaml",
        "make tests",
        "python -m trials.none",
    ],
)
def test_a_command_that_is_not_there_is_noticed(command: str) -> None:
    assert wrong(command)


def dead_links(page: Path, text: str) -> list[str]:
    """Targets of links that are no file beside the page, or no heading of one."""
    dead = []
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        name, _, heading = target.partition("#")
        file = page.parent / name if name else page
        titles = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.M) if heading and file.is_file() else []
        known = [re.sub(r"[^\w -]", "", title).strip().lower().replace(" ", "-") for title in titles]
        dead += [target] if not file.exists() or (heading and heading not in known) else []
    return dead


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(TOP)))
def test_every_link_of_the_page_leads_somewhere(page: Path) -> None:
    assert dead_links(page, page.read_text(encoding="utf-8")) == []


def test_a_dead_link_is_noticed() -> None:
    links = "[a](docs/none.md) [b](docs/trials.md#none) [c](docs/trials.md#attacks)"
    assert dead_links(TOP / "README.md", links) == ["docs/none.md", "docs/trials.md#none"]


def stated_constants(page: str) -> dict[str, list[float]]:
    """Constants of the diagnosis, by `module.NAME`, as the table of its page states them."""
    rows = re.findall(r"^\| (`\w+\.[A-Z_]+`(?:, `\w+\.[A-Z_]+`)*) \| ([^|]+) \|", page, re.M)
    return {
        name: [float(v) for v in value.split(", ")]
        for names, values in rows
        for name, value in zip(re.findall(r"`([^`]+)`", names), values.split("; "), strict=True)
    }


def test_constants_of_the_diagnosis_are_those_of_the_code() -> None:
    stated = stated_constants((TOP / "docs" / "diagnosis.md").read_text(encoding="utf-8"))
    assert len(stated) > 50
    for name, value in stated.items():
        module, constant = name.split(".")
        known = getattr(importlib.import_module(f"errpipe.diagnosis.{module}"), constant)
        assert value == pytest.approx(list(np.atleast_1d(known))), name
