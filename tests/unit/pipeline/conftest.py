"""The engine's tests must not see an edit of errpipe's own source between two runs."""

from __future__ import annotations

import pytest

from errpipe.pipeline import lock


@pytest.fixture(autouse=True)
def _same_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "package_code", lambda: "source")
