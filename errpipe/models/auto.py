"""All thermal families that fit the recording, or the named ones, in one competition."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from pydantic import Field, field_validator

from errpipe.models._thermal import ThermalFamily

if TYPE_CHECKING:
    from errpipe.models._base import Family
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem


class Auto(ThermalFamily):
    """Compare families on held-out runs, seasons and duty cycles, and fit their best weighted sum."""

    family: Literal["auto"] = Field("auto", description="Model family.")
    among: tuple[str, ...] = Field((), description="Families that compete; empty: all thermal ones.")

    @field_validator("among")
    @classmethod
    def _known(cls, among: tuple[str, ...]) -> tuple[str, ...]:
        from errpipe.errors import did_you_mean

        known = [kind.family_name() for kind in competitors()]
        for name in among:
            if name not in known:
                raise ValueError(f"found {name!r} (allowed: {', '.join(known)}).{did_you_mean(name, known)}")
        return among

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """The entrants of every family that competes; for one run or season, non-linear ones only if named.

        Single days of 108 simulated machines (seed 901 of `trials.thermal --log-days 1` and formulas): with a neural
        network the residual of later days was 0.112 to 0.245 of uncompensated, one worse; 0.109 to 0.230 without.
        A turning centre's winter, fitted on spring with one: 8.7 um instead of 6.9.
        """
        little = problem.one_run or self.one_environment(problem)
        shared = {name: getattr(self, name) for name in ThermalFamily.model_fields}
        chosen = [
            kind
            for kind in competitors()
            if (kind.family_name() in self.among if self.among else not (little and kind.nonlinear))
        ]
        return [entrant for kind in chosen for entrant in kind.competitor(shared).entrants(problem)]


def competitors() -> list[type[Family]]:
    """The families of the registry that compete, by name; including those that the pipeline does not name."""
    from errpipe.models import FAMILIES

    kinds = [kind for kind in FAMILIES if kind.competes and kind is not Auto]
    return sorted(kinds, key=lambda kind: kind.family_name())
