"""The nearest allowed word: by its letters, or by what it means."""

from __future__ import annotations

import pytest

from errpipe.domain.recording import ROLE_UNITS
from errpipe.errors import did_you_mean
from errpipe.targets import TARGETS


@pytest.mark.parametrize(
    ("word", "meant"),
    [("deviation", "error"), ("target", "command"), ("temperatur", "temperature"), ("dir", "direction"), ("qqq", "")],
)
def test_a_role_by_its_meaning(word: str, meant: str) -> None:
    """A deviation is what the role `error` holds; by its letters it is nearest to `direction`."""
    assert did_you_mean(word, ROLE_UNITS) == (f" Did you mean {meant}?" if meant else "")


@pytest.mark.parametrize(
    ("maker", "first"), [("siemens", "sinumerik_"), ("beckhoff", "beckhoff_"), ("fanuc", "fanuc_")]
)
def test_every_format_of_a_maker(maker: str, first: str) -> None:
    names = [name for name in TARGETS.tags if name.startswith(first)]
    said = did_you_mean(maker, TARGETS.tags)
    assert names and all(name in said for name in names)
