"""Trees of the package's files live as long as the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.contract.sources import tree_of


@pytest.fixture(scope="package", autouse=True)
def _trees() -> Iterator[None]:
    yield
    tree_of.cache_clear()
