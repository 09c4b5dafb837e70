"""Model families: one file and one registry entry each. A family states its options, its fit and its validation.

The stage `fit` offers every family; validation, export and report name none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from errpipe.errors import VerifyError
from errpipe.models._base import Family
from errpipe.yamlfile import Choice

DEFAULT = "terms"  # if a pipeline names no family
SEVERAL = "auto"  # if it names a list of families
BY_FIT = (
    *(SEVERAL, "bilinear", "lagged", "network", "neural", "neural_volume", "nothing", "plate", "rises", "season"),
    DEFAULT,
)
BY_ANOTHER_STAGE = ("direct", "force")
FAMILIES: Choice[type[Family]] = Choice.of_files("errpipe.models", "family", (*BY_FIT, *BY_ANOTHER_STAGE))

__all__ = ["BY_FIT", "DEFAULT", "FAMILIES", "SEVERAL", "Family", "family_of", "procedure"]


def family_of(document: Mapping[str, Any]) -> Family:
    """The family of `fit.json`, with its options. Raises VerifyError if it is unknown."""
    asked = {key: value for key, value in document.items() if key not in ("fit", "model")}
    name = asked.get("family")
    if name not in FAMILIES.tags:
        raise VerifyError(f"fit.json: the model family {name!r} is unknown")
    family: Family = FAMILIES[name].model_validate(asked)
    return family


def procedure(family: Family, model: str) -> dict[str, Any]:
    """The fit as recorded in `fit.json`, to be repeated without a held-out group; model: its fingerprint."""
    return {"fit": 1, "model": model, **family.model_dump(mode="json")}
