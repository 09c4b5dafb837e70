"""Every YAML block of the documentation is valid: a pipeline as `errpipe check` reads it, or a recording.yaml."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from errpipe import yamlfile
from errpipe.domain.recording import Manifest
from errpipe.errors import ConfigError
from errpipe.pipeline.spec import load_pipeline
from errpipe.stages import STAGES
from tests.contract.test_docs import PAGES, TOP

# What a page leaves out of a block because the text beside it says so.
PIPELINE = "pipeline: 1\ntitle: a block of the documentation\n"
MANIFEST = "recording: 1\ntitle: a block of the documentation\ntables: [recording.csv]\n"
OF_A_PLUGIN = "CONTRIBUTING.md"  # its pipelines name new plug-ins; test_contributing.py runs them
BEFORE_AN_EXPORT = """stages:
  - {kind: simulate}
  - {kind: ingest}
  - {kind: fit, components: [{component: EXX, terms: [{term: offset}]}]}
  - {kind: validate}
"""


def blocks(text: str) -> list[str]:
    """Fenced blocks, and indented stages as the end of a pipeline."""
    fenced = re.findall(r"^```ya?ml\n(.*?)^```", text, re.M | re.S)
    ends = re.findall(r"(?:^ {4}- \{?kind: export.*\n)(?:^ {4,}\S.*\n)*", text, re.M)
    return [*fenced, *(BEFORE_AN_EXPORT + re.sub(r"^  ", "", end, flags=re.M) for end in ends)]


BLOCKS = [
    pytest.param(block, id=f"{page.relative_to(TOP)}:{number}")
    for page in PAGES
    if page.name != OF_A_PLUGIN
    for number, block in enumerate(blocks(page.read_text(encoding="utf-8")))
]


def check(block: str, folder: Path) -> None:
    """Raise ConfigError if a block is neither a valid pipeline nor a valid manifest."""
    path = folder / "block.yaml"
    if re.search(r"^stages:", block, re.M):
        path.write_text(block if "pipeline:" in block else PIPELINE + block, encoding="utf-8")
        load_pipeline(path, STAGES)
    else:
        path.write_text(block if "recording:" in block else MANIFEST + block, encoding="utf-8")
        yamlfile.load(path, Manifest)


@pytest.mark.parametrize("block", BLOCKS)
def test_every_block_is_valid(block: str, tmp_path: Path) -> None:
    check(block, tmp_path)


@pytest.mark.parametrize(
    "block",
    [
        "stages:\n  - {kind: simulate}\n  - {kind: ingest, recordng: x}\n",
        "stages:\n  - {kind: exprot}\n",
        *blocks("    - kind: export\n      readings_per_shft: 8\n"),
        "columns:\n  x: {role: position, axis: X, unit: furlong}\n",
    ],
)
def test_a_wrong_block_is_noticed(block: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError):
        check(block, tmp_path)


def test_blocks_are_found() -> None:
    assert len(BLOCKS) >= 7
