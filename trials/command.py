"""What the commands of all trials share: where reports are written, which diagnoses failed, cases in shares."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np


def add_reports(parser: argparse.ArgumentParser) -> None:
    """The options --keep, --json and --markdown."""
    parser.add_argument("--keep", type=Path, help="folder to leave cases, answers and diagnoses in")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)


def write_reports(a: argparse.Namespace, text: str, document: Mapping[str, Any]) -> None:
    """The table and the document, into the files that were asked for."""
    if a.markdown:
        a.markdown.write_text(text)
    if a.json:
        a.json.write_text(json.dumps({"seed": a.seed, **document}, indent=1) + "\n")


def print_failures(done: Sequence[tuple[str, float, str]]) -> None:
    """Diagnoses that failed, and how long all of them took. done: (case, seconds, what went wrong)."""
    for name, _, trouble in done:
        if trouble:
            print(f"{name} failed: {trouble}")
    print(f"longest diagnosis {max(s for _, s, _ in done):.1f} s, all {sum(s for _, s, _ in done):.0f} s of work")


def in_shares(rng: np.random.Generator, mix: Mapping[str, float], cases: int, tiers: Sequence[str]) -> list[str]:
    """So many tiers in the shares of a mix, by largest remainder, in random order."""
    share = np.array([mix[t] for t in tiers])
    exact = share / share.sum() * cases
    count = np.floor(exact).astype(int)
    for i in np.argsort(count - exact)[: cases - count.sum()]:
        count[i] += 1
    drawn = [t for t, n in zip(tiers, count, strict=True) for _ in range(n)]
    rng.shuffle(drawn)
    return drawn
