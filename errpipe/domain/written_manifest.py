"""A recording manifest as a person writes it: everything that can be wrong before a table is opened.

`Manifest` itself only defines the keys. When a manifest is read, every role with a unit must state one that fits its
component, components are ISO 230-1, axes ISO 841, and no table lies outside the folder.
"""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import PurePosixPath
from typing import Annotated

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from errpipe.domain import components, units
from errpipe.domain.recording import Column, Manifest
from errpipe.errors import did_you_mean
from errpipe.yamlfile import InvalidKey

MAX_COLUMNS = 1024  # that are used; cleaning compares each with the others, and 400 sensors take it ten seconds
_AXIS = re.compile(r"[A-Z]\d?")


def _inside(path: str) -> str:
    parts = PurePosixPath(path.replace("\\", "/"))
    if parts.is_absolute() or ".." in parts.parts or re.match(r"[A-Za-z]:", path) or not path:
        raise ValueError(f"{path!r} is outside the folder (allowed: a file of the manifest's own folder)")
    return path


class WrittenColumn(Column):
    """A column with a unit wherever its role has one, an ISO component, an ISO axis."""

    @field_validator("axis")
    @classmethod
    def _iso_axis(cls, axis: str | None, info: ValidationInfo) -> str | None:
        if info.data.get("role") != "ignore" and axis is not None and not _AXIS.fullmatch(axis):
            raise ValueError(f"{axis!r} is not an ISO 841 axis (allowed: a capital letter such as X, X1, C)")
        return axis

    @field_validator("component")
    @classmethod
    def _iso_component(cls, component: str | None, info: ValidationInfo) -> str | None:
        if info.data.get("role") != "ignore" and component is not None:
            components.parse(component)
        return component

    @field_validator("epoch")
    @classmethod
    def _iso_epoch(cls, epoch: str | None) -> str | None:
        try:
            datetime.fromisoformat(epoch or "2000-01-01")
        except ValueError:
            raise ValueError(f"{epoch!r} is not ISO 8601 (allowed: such as 2026-01-31T08:00:00Z)") from None
        return epoch

    @model_validator(mode="after")
    def _unit_of_the_component(self) -> WrittenColumn:
        try:
            convert = units.conversion(self.role, self.unit)
        except ValueError as err:
            raise InvalidKey(("unit",), str(err)) from None
        if self.role in ("error", "simulated") and convert is not None:
            allowed = components.allowed_units(str(self.component))
            if convert.unit not in allowed:
                wanted = " or ".join(allowed)
                raise InvalidKey(("unit",), f"{self.component} is measured in {wanted} (found {self.unit!r})")
        return self


class WrittenManifest(Manifest):
    """A manifest whose columns are `WrittenColumn`s, each response and the clock once, and tables of its own folder."""

    tables: tuple[Annotated[str, AfterValidator(_inside)], ...] = Field(min_length=1)
    columns: dict[str, WrittenColumn]  # type: ignore[assignment]  # narrower than a Manifest's, and frozen

    @model_validator(mode="after")
    def _so_many_columns(self) -> WrittenManifest:
        used = sum(c.role != "ignore" for c in self.columns.values())
        if used > MAX_COLUMNS:
            raise InvalidKey(("columns",), f"{used} columns (at most {MAX_COLUMNS}; give the others `role: ignore`)")
        return self

    @model_validator(mode="after")
    def _one_of_each(self) -> WrittenManifest:
        for column_name, c in self.columns.items():
            self._derived_from_what_is_there(column_name, c)
        seen: dict[tuple[str | None, ...], str] = {}
        for column_name, c in self.columns.items():
            if c.role in ("run", "time", "error", "simulated"):
                what = (c.role, c.component)
                if what in seen:
                    of = f" of {c.component}" if c.component else ""
                    raise InvalidKey(
                        ("columns", column_name),
                        f"columns {seen[what]!r} and {column_name!r} are both role {c.role}{of} (allowed: one;"
                        " give the other role ignore)",
                    )
                seen[what] = column_name
        if len(set(self.tables)) < len(self.tables):
            raise InvalidKey(("tables",), "a table is listed twice (its rows would count twice)")
        return self

    def _derived_from_what_is_there(self, column_name: str, c: Column) -> None:
        """Derived columns name columns that exist: a difference two positions, a multiple a column of the table."""
        if c.derived is None:
            return
        place = ("columns", column_name, "derived")
        named = c.derived.minus or ((c.derived.of,) if c.derived.of is not None else ())
        for name in named:
            if name not in self.columns:
                near = did_you_mean(str(name), self.columns)
                raise InvalidKey(place, f"there is no column {name!r} (columns: {', '.join(self.columns)}).{near}")
        if c.derived.of is not None and self.columns[c.derived.of].derived is not None:
            raise InvalidKey(place, f"{c.derived.of!r} is derived itself (allowed: a column of the table)")
        for name in c.derived.minus or ():
            if self.columns[name].role not in ("position", "command", "actual"):
                raise InvalidKey(place, f"{name!r} is no position (role {self.columns[name].role})")
            own = self.columns[name].derived
            if own is not None and own.minus is not None:
                raise InvalidKey(place, f"{name!r} is a difference itself (allowed: a column of the table)")
        if c.derived.minus is not None and c.unit not in ("um", "urad"):
            where = ("columns", column_name, "unit")
            raise InvalidKey(where, f"a difference of positions is in um or urad (found {c.unit!r})")
