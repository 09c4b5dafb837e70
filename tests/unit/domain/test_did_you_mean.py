"""The nearest allowed word: by its letters, or by what it means."""

from __future__ import annotations

import pytest

from errpipe.domain.recording import ROLE_UNITS
from errpipe.errors import did_you_mean


@pytest.mark.parametrize(
    ("word", "meant"),
    [("deviation", "error"), ("target", "command"), ("temperatur", "temperature"), ("dir", "direction"), ("qqq", "")],
)
def test_a_role_by_its_meaning(word: str, meant: str) -> None:
    """A deviation is what the role `error` holds; by its letters it is nearest to `direction`."""
    assert did_you_mean(word, ROLE_UNITS) == (f" Did you mean {meant}?" if meant else "")
