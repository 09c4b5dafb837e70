"""A folder with a recording manifest, `recording.yaml`, and its tables (CSV with a header row, or Parquet).

The manifest says what every column is; nothing is guessed. Units are checked and converted here, once.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from errpipe.domain import units
from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import ConfigError, DataError, Problem

LABELS = ("run", "group")


def load_manifest(path: Path) -> Manifest:
    """The manifest of a folder (or the file itself). Raises ConfigError with every problem."""
    path = Path(path)
    path = path / "recording.yaml" if path.is_dir() else path
    try:
        from errpipe import yamlfile
    except ImportError:
        from pydantic import ValidationError
        from ruamel.yaml import YAML

        try:
            return Manifest.model_validate(YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8")))
        except ValidationError as err:
            problems = [Problem(str(path), 0, 0, ".".join(map(str, e["loc"])), e["msg"]) for e in err.errors()]
            raise ConfigError(problems) from None
    return yamlfile.load(path, Manifest)


def read(folder: Path) -> Recording:
    """Read a recording folder into canonical units. Raises ConfigError or DataError."""
    folder = Path(folder)
    manifest = load_manifest(folder)
    tables = [_read_table(folder / name, manifest) for name in manifest.tables]
    table = pa.concat_tables(tables)
    frame = {}
    columns = dict(manifest.columns)
    for name, column in manifest.columns.items():
        if column.role == "ignore":
            continue
        if column.role in LABELS:
            frame[name] = table[name].to_pandas().astype(str)
            continue
        convert = units.conversion(column.role, column.unit)
        values = table[name].to_numpy().astype(np.float64)
        if convert is not None:
            values = np.asarray(convert(values))
            columns[name] = column.model_copy(update={"unit": convert.unit})
        frame[name] = values
    return Recording(manifest.model_copy(update={"columns": columns}), pd.DataFrame(frame))


def _read_table(path: Path, manifest: Manifest) -> pa.Table:
    wanted = [n for n, c in manifest.columns.items() if c.role != "ignore"]
    types = {n: pa.string() if manifest.columns[n].role in LABELS else pa.float64() for n in wanted}
    if not path.is_file():
        raise DataError(f"{path}: no such table")
    try:
        if path.suffix == ".parquet":
            return pq.read_table(path, columns=wanted).cast(pa.schema(list(types.items())))
        options = pacsv.ConvertOptions(
            column_types=types, include_columns=wanted, null_values=[""], strings_can_be_null=False
        )
        return pacsv.read_csv(path, convert_options=options)
    except (pa.ArrowInvalid, KeyError) as err:
        raise DataError(f"{path}: {err}") from None
