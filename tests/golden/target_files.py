"""Files of every controller format for one small machine, kept in tests/golden/targets: a change shows.

`python -m tests.golden.target_files` writes them again. The machine is 10 um too long at X = +500 and loses 6 um at
reversals; formats that cannot say that get the machine they are for (a bent one, a warm one).
"""

from __future__ import annotations

import shutil
from pathlib import Path

from errpipe.domain.table import CompensationTable
from errpipe.targets import TARGETS, Target
from errpipe.targets._whole import WholeTable
from tests.unit.targets import machines

FOLDER = Path(__file__).with_name("targets")


def sample(target: type[Target]) -> CompensationTable:
    """The machine of a format."""
    return machines.long_with_lost_motion() if "screw" in target.holds else machines.sample(target)


def files(target: type[Target]) -> dict[str, str] | None:
    """File name -> text; None for formats that hold the table's own bytes, which its evaluators' tests compare."""
    made = target.write(sample(target))
    return None if isinstance(target.read_back(made), WholeTable) else made


def main() -> None:
    shutil.rmtree(FOLDER, ignore_errors=True)
    for target in TARGETS:
        for name, text in (files(target) or {}).items():
            path = FOLDER / target.name / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
