"""A key pair and two tables, as every test of the registry needs them."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe.registry import minisign
from errpipe.tables import ect
from tests.unit.targets import machines


@pytest.fixture(scope="module")
def key() -> minisign.SecretKey:
    return minisign.generate()


@pytest.fixture
def where(tmp_path: Path, key: minisign.SecretKey) -> Path:
    minisign.write_pair(key, tmp_path / "keys")
    ect.write(machines.too_long_at_plus_x(), tmp_path / "one.ect")
    ect.write(machines.wavy_both_directions(), tmp_path / "two.ect")
    return tmp_path
