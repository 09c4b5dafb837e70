"""Every format of the registry has a sample in tests/data/formats, recognised and read without being named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe import formats
from errpipe.domain import units
from errpipe.formats import FORMATS

SAMPLES = Path(__file__).parents[2] / "data" / "formats"


def sample_of(name: str) -> Path:
    """The one file or folder named after a format."""
    matches = [path for path in SAMPLES.iterdir() if path.name.split(".")[0] == name]
    assert len(matches) == 1, f"tests/data/formats needs one sample named {name} (found {[p.name for p in matches]})"
    return matches[0]


@pytest.mark.parametrize("file_format", FORMATS, ids=lambda file_format: file_format.name)
def test_a_sample_is_recognised_and_read_in_canonical_units(file_format) -> None:
    sample = sample_of(file_format.name)
    assert [f.name for f in FORMATS if f.sniff(sample)] == [file_format.name]
    required = [name for name, field in file_format.Options.model_fields.items() if field.is_required()]
    assert not required, f"a file is read without being asked about: {required} need a default"
    recording = formats.read(sample)
    responses = recording.names("error")
    assert len(recording) > 0 and responses
    assert np.isfinite(recording.array(responses[0])).any()
    for name, column in recording.manifest.columns.items():
        conversion = units.conversion(column.role, column.unit) if column.unit is not None else None
        assert conversion is None or conversion.identity, f"{name}: {column.unit} is not canonical ({conversion.unit})"


@pytest.mark.parametrize("file_format", FORMATS, ids=lambda file_format: file_format.name)
def test_sniff_never_raises(file_format, tmp_path: Path) -> None:
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "bytes").write_bytes(bytes(range(256)))
    for path in (tmp_path, tmp_path / "empty", tmp_path / "bytes", tmp_path / "nothing"):
        assert file_format.sniff(path) is False
