"""A recording folder as a manifest and a table: written by generators, read from real recordings, never judged here."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from ruamel.yaml import YAML

Array = np.ndarray


@dataclass
class Sheet:
    """One recording: what the manifest says of each column, and the rows."""

    title: str
    table: pd.DataFrame
    columns: dict[str, dict[str, Any]]
    machine: str = ""
    constants: dict[str, dict[str, Any]] = field(default_factory=dict)

    def names(self, role: str) -> list[str]:
        """Columns of a role, in the order of the manifest."""
        return [n for n, spec in self.columns.items() if spec["role"] == role]

    def values(self, name: str) -> Array:
        return self.table[name].to_numpy(float)

    def runs(self) -> Array:
        """The run of each row as text; one run where no column says so."""
        named = self.names("run")
        return self.table[named[0]].astype(str).to_numpy() if named else np.full(len(self.table), "all")

    def responses(self) -> dict[str, tuple[str, str | None]]:
        """component -> (error column, simulated column or None)."""
        twins = {self.columns[n]["component"]: n for n in self.names("simulated")}
        return {(c := self.columns[n]["component"]): (n, twins.get(c)) for n in self.names("error")}


def read(folder: Path) -> Sheet:
    """A recording folder. Raises OSError and KeyError where it is none."""
    manifest = YAML(typ="safe").load((folder / "recording.yaml").read_text())
    specs = {n: dict(s) for n, s in manifest["columns"].items()}
    as_text = {n: str for n, s in specs.items() if s["role"] in ("run", "group")}
    table = pd.concat([pd.read_csv(folder / name, dtype=as_text) for name in manifest["tables"]], ignore_index=True)
    return Sheet(
        manifest.get("title", folder.name), table, specs, manifest.get("machine", ""), manifest.get("constants") or {}
    )


def write(folder: Path, sheet: Sheet) -> None:
    """recording.yaml and recording.csv; equal sheets give equal bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    manifest: dict[str, Any] = {"recording": 1, "title": sheet.title, "machine": sheet.machine or "machine"}
    manifest["tables"] = ["recording.csv"]
    if sheet.constants:
        manifest["constants"] = sheet.constants
    manifest["columns"] = sheet.columns
    yaml = YAML()
    yaml.default_flow_style = None
    with (folder / "recording.yaml").open("w") as stream:
        yaml.dump(manifest, stream)
    sheet.table[list(sheet.columns)].to_csv(folder / "recording.csv", index=False)


def rounded(values: Array, step: float) -> Array:
    """A display of that step; 12 significant digits, so that files stay short."""
    shown = np.round(values / step) * step if step > 0 else values
    digits = int(np.clip(np.ceil(-np.log10(step)) + 1, 0, 15)) if step > 0 else 12
    return np.round(shown, digits)


def nice_step(size: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that does not exceed `size`."""
    power = 10.0 ** np.floor(np.log10(size))
    return float(power * max(m for m in (1, 2, 5) if m * power <= size * 1.0000001))
