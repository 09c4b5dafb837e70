"""The document of `validation.json` without its held-out rows, as the tests of models judge them."""

from __future__ import annotations

from typing import Any

from errpipe.domain.recording import Recording
from errpipe.models import Family
from errpipe.validation.held_out import cross_validate


def held_out(recording: Recording, family: Family, *args: Any, **options: Any) -> dict[str, Any]:
    """First part of `cross_validate`: scheme, method and figures of each component."""
    return cross_validate(recording, family, *args, **options)[0]
