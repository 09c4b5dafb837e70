"""No thermal compensation: the reference for every other family; it exports nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily

if TYPE_CHECKING:
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem


class Nothing(ThermalFamily):
    """Predict no deviation. It is never exported; its validation shows the uncompensated error."""

    family: Literal["nothing"] = Field("nothing", description="Model family.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """No entrant."""
        return ()
