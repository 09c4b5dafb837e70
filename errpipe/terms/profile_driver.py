"""Any profile over position times any driver: the general form of every compensation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from errpipe.domain import driver as d
from errpipe.domain.recording import FrozenModel, Recording
from errpipe.drivers.evaluation import carried, drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, position_name
from errpipe.terms import _profiles as shapes
from errpipe.terms._base import Example, Parameter, Term
from errpipe.terms._example import typical_example
from errpipe.yamlfile import quantity


class Factor(FrozenModel):
    """One factor of a driver: an input, from where it counts, how late it acts and to what power."""

    input: str = Field(description="Column of the recording, channel of the controller.")
    reference: float | Literal["first"] = quantity(
        "of the input", "What is taken off: a value, or the first one seen.", 0.0
    )
    minus: str | None = Field(None, description="Second input taken off: a gradient.")
    lag: bool = Field(False, description="Acts through a first-order lag whose time constant is solved for.")
    tau: tuple[float, float] = quantity("s", "Bounds of that time constant.", (60.0, 30000.0))
    power: float | None = quantity("1", "sign(u) |u|^power.", None, gt=0)
    unit: str = Field("K", description="Unit of the input, as used in the parameter's unit.")

    def driver(self, tau: float | None) -> d.Driver:
        """The factor as a driver, its time constant put in."""
        node: d.Driver = d.Input(name=self.input)
        if self.minus is not None:
            node = d.Affine(weights=(1.0, -1.0), of=(node, d.Input(name=self.minus)))
        if self.reference == "first":
            node = d.Affine(weights=(1.0, -1.0), of=(node, d.First(of=node)))
        elif self.reference:
            node = d.Affine(offset=-float(self.reference), weights=(1.0,), of=(node,))
        if self.lag:
            node = d.Lag(of=node, tau_up=tau, tau_down=tau)
        return node if self.power is None else d.Power(of=node, exponent=self.power)

    def in_unit(self) -> str:
        """Unit of the factor's value."""
        return self.unit if self.power in (None, 1.0) else f"{self.unit}{self.power:g}"


def _tag_of(value: Any) -> str:
    operation = value.get("op") if isinstance(value, dict) else getattr(value, "op", None)
    return "driver" if operation else "factor"


AnyFactor = Annotated[Annotated[Factor, Tag("factor")] | Annotated[d.Driver, Tag("driver")], Discriminator(_tag_of)]


class ProfileDriver(Term):
    """A shape over position whose size follows the machine's state.

    Equation   deviation(x, state) = profile(x) * product of factors(state)
    Assumes    constant shape, only its size changes (Ni 1997: errors keep their profile, slopes vary)
    Typical    1..100 um
    Moves      positive gain: further where profile and driver are positive
    Source     Ni 1997, mixed error components
    """

    term: Literal["profile_driver"] = "profile_driver"
    axis: str | None = Field(None, description="Axis of the profile; none for a level.")
    profile: shapes.Profile = Field(shapes.Level(), description="Shape over position.")
    driver: tuple[AnyFactor, ...] = Field((), description="Factors; none for a static profile.")
    rotary: bool = Field(False, description="The axis turns: lengths in deg.")

    def settled(self, recording: Recording) -> ProfileDriver:
        """The term with the profile's span and the axis' kind written down."""
        if self.axis is None:
            return self
        column = recording.manifest.columns[position_name(recording, self.axis)]
        rotary = column.unit in ("deg", "rad")
        profile = self.profile.settled(position(recording, self.axis))
        return self.model_copy(update={"profile": profile, "rotary": rotary})

    def linear(self) -> tuple[Parameter, ...]:
        per = "/".join(f.in_unit() for f in self.driver if isinstance(f, Factor) and f.in_unit())
        return shapes.parameters(self.profile, self.rotary, per)

    def penalty(self) -> np.ndarray | None:
        return self.profile.penalty()

    def nonlinear(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(name, "s", (max(600.0, f.tau[0]), min(15000.0, f.tau[1])), f.tau, f"time constant of {f.input}")
            for name, f in self._lagged()
        )

    def _lagged(self) -> list[tuple[str, Factor]]:
        lagged = [f for f in self.driver if isinstance(f, Factor) and f.lag]
        if len(lagged) == 1:
            return [("tau", lagged[0])]
        return [
            (f"tau_{f.input}" + (f"_{k}" if [g.input for g in lagged].count(f.input) > 1 else ""), f)
            for k, f in enumerate(lagged)
        ]

    def _driver(self, taus: tuple[float, ...] | list[float]) -> d.Driver:
        remaining = list(taus)
        nodes = []
        for f in self.driver:
            nodes.append((f.driver(remaining.pop(0) if f.lag else None)) if isinstance(f, Factor) else f)
        if not nodes:
            return d.ONE
        return nodes[0] if len(nodes) == 1 else d.Product(of=tuple(nodes))

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        at = (position_name(recording, self.axis),) if self.axis else ()
        return tuple(dict.fromkeys((*d.inputs(self._driver([1.0] * len(self._lagged()))), *at)))

    @classmethod
    def example(cls) -> Example:
        return typical_example(
            cls(
                axis="X",
                profile=shapes.Line(origin=100.0),
                driver=(Factor(input="T_nut", reference="first", lag=True),),
            )
        )

    def splittable_in_batches(self, recording: Recording) -> bool:
        return carried(self._driver([1.0] * len(self._lagged())), recording)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        size = drive(self._driver(nonlinear), recording)[:, None]
        if self.axis is None:
            return size
        return self.profile.basis(position(recording, self.axis), self.rotary) * size

    def has_message(self, parameters: Mapping[str, float]) -> bool:
        """Not for a fixed curve with a gain of 1, which the table of curves shows."""
        return list(parameters.values()) != [1.0]

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        driver = self._driver(self.nonlinear_values(parameters))
        gains = self.gain_values(parameters)
        if self.axis is None or isinstance(self.profile, shapes.Level):
            return (Lowered(d.Affine(weights=(float(gains[0]),), of=(driver,))),)
        period = getattr(self.profile, "period", None)
        return (Lowered(driver, self.axis, shapes.curve(self.profile, gains, self.rotary), period),)
