"""Model families: one file each, and one line here. A family states its options and knows how it is fitted and judged.

The stage `fit` offers every family; validation, export and report name none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from errpipe.models._base import Family
from errpipe.models.auto import Auto
from errpipe.models.direct import Direct
from errpipe.models.lagged import Lagged
from errpipe.models.network import Network
from errpipe.models.nothing import Nothing
from errpipe.models.plate import Plate
from errpipe.models.rises import Rises
from errpipe.models.season import Season
from errpipe.models.terms import Terms

FAMILIES: tuple[type[Family], ...] = (Auto, Direct, Lagged, Network, Nothing, Plate, Rises, Season, Terms)

__all__ = ["DEFAULT", "FAMILIES", "Family", "family_of", "procedure"]

DEFAULT = Terms  # where a pipeline names no family


def family_of(document: Mapping[str, Any]) -> Family:
    """The family behind `fit.json`, with what it was asked for. Raises VerifyError where it is unknown."""
    from errpipe.errors import VerifyError

    asked = {key: value for key, value in document.items() if key != "fit"}
    for kind in FAMILIES:
        if kind.family_name() == asked.get("family"):
            return kind.model_validate(asked)
    raise VerifyError(f"fit.json: the model family {asked.get('family')!r} is not known")


def procedure(family: Family) -> dict[str, Any]:
    """What `fit.json` says of a fit, so that it can be repeated without a held-out group."""
    return {"fit": 1, **family.model_dump(mode="json")}
