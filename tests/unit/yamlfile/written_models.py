"""A small model of terms as a user writes it, and the refusal of a text."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import Field, model_validator

from errpipe.errors import ConfigError
from errpipe.yamlfile import InvalidKey, Options, parse


class Line(Options):
    kind: Literal["line"]
    slope: float = Field(1.0, gt=0, json_schema_extra={"unit": "um/m"}, description="Slope.")


class Step(Options):
    kind: Literal["step"]
    height: float = Field(description="Height of the step.", json_schema_extra={"unit": "um"})
    sides: tuple[float, float] = Field((0.0, 1.0), json_schema_extra={"unit": "mm"})

    @model_validator(mode="after")
    def _sides_differ(self) -> Step:
        if self.sides[0] == self.sides[1]:
            raise InvalidKey(("sides", 1), "equals the first side")
        return self


class Model(Options):
    version: Literal[1]
    title: str = ""
    robust: bool = False
    count: int = Field(3, ge=1, le=9)
    spread: float | Literal["auto"] = "auto"
    terms: tuple[Annotated[Line | Step, Field(discriminator="kind")], ...] = ()
    limits: dict[str, Line] = {}
    name: Literal["red", "green", "blue"] = "red"


def problems(text: str, model: object = Model) -> list[str]:
    """The lines of the refusal of a text."""
    with pytest.raises(ConfigError) as caught:
        parse(text, "f.yaml").validate(model)
    return str(caught.value).splitlines()
