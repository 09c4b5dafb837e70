"""A serial machine as a machinist describes it: the chain from workpiece to tool, its axes, where errors are defined.

    chain: [workpiece, Z', bed, X, Y, spindle, tool]

A prime marks an axis that carries the workpiece (ISO 841); `bed` is stationary. All points are in mm in the
machine's coordinates (ISO 841) with every axis at 0. Axis coordinates count the way ISO 841 counts them: a
positive motion moves the tool in the axis' direction as seen from the workpiece, whichever of the two moves.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from errpipe.domain.recording import FrozenModel
from errpipe.errors import did_you_mean
from errpipe.yamlfile import quantity

Vector = tuple[float, float, float]
LETTERS = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
PARALLEL_AXIS = {"U": "X", "V": "Y", "W": "Z", "P": "X", "Q": "Y", "R": "Z", "A": "X", "B": "Y", "C": "Z"}


def _unit_vector(value: Vector) -> Vector:
    size = sqrt(sum(v * v for v in value))
    if size == 0.0:
        raise ValueError("a direction cannot be 0, 0, 0")
    return (value[0] / size, value[1] / size, value[2] / size)


Direction = Annotated[Vector, AfterValidator(_unit_vector)]


class Axis(FrozenModel):
    """One axis of motion and where its six error components are defined.

    The six components are the motion of what lies on the tool's side of the axis relative to what lies on
    the workpiece's side (`errors_of: tool_side`), so that every axis counts with the same sign at the tool.
    `errors_of: carriage` reads them as the motion of the carriage itself, which for an axis that carries the
    workpiece is the opposite.
    """

    kind: Literal["linear", "rotary"] = Field(description="how it moves")
    travel: tuple[float, float] = quantity("of the axis", "lowest and highest position, mm or deg")
    direction: Direction | None = quantity("1", "of motion or turning; the letter's own where left out", None)
    reference: Vector = quantity(
        "mm", "point its errors are defined at; a rotary axis' line runs through it", (0.0, 0.0, 0.0)
    )
    reference_on: Literal["carriage", "guideway"] | None = Field(
        None,
        description="whether that point travels along, and of a rotary axis the components' directions turn with it; "
        "left out: carriage of a linear, guideway of a rotary axis (ISO 230-1, 230-7: its directions stand)",
    )
    errors_of: Literal["tool_side", "carriage"] = Field(
        "tool_side", description="whose motion the six components are: the tool's side's, or the carriage's own"
    )
    datum: float | None = quantity(
        "of the axis", "position at which its positioning deviation is zero, mm or deg", None
    )
    drifts: bool = Field(False, description="whether the origin of its frame drifts (three components)")

    @model_validator(mode="after")
    def _ordered(self) -> Axis:
        if not self.travel[0] < self.travel[1]:
            raise ValueError(f"travel {list(self.travel)} is not lowest then highest")
        return self

    @property
    def errors_travel(self) -> bool:
        """Whether the point and the directions of the six components move with the axis."""
        return (self.reference_on or ("carriage" if self.kind == "linear" else "guideway")) == "carriage"

    @property
    def zero(self) -> float:
        """Position at which positioning deviation is zero: `datum`, else 0 where reachable, else the nearer end."""
        return min(max(0.0, self.travel[0]), self.travel[1]) if self.datum is None else self.datum


class Spindle(FrozenModel):
    """The spindle nose, and whether growth (three components) and tilt (two) are among the errors."""

    position: Vector = quantity("mm", "of the nose", (0.0, 0.0, 0.0))
    direction: Direction = quantity("1", "of its axis", (0.0, 0.0, 1.0))
    growth: bool = Field(False, description="whether its growth is among the errors (three components)")
    tilt: bool = Field(False, description="whether its tilt is among the errors (two components)")


class Tool(FrozenModel):
    """Tool tip = mount + offset + length along `direction`; length and offset may be changed at run time."""

    mount: Vector | None = quantity("mm", "where it is held; the spindle's position where left out", None)
    direction: Direction = quantity("1", "from the mount to the tip", (0.0, 0.0, -1.0))
    length: float = quantity("mm", "from the mount along the direction", 0.0, ge=0)
    offset: Vector = quantity("mm", "of the tip, added to the length", (0.0, 0.0, 0.0))


class Machine(FrozenModel):
    """Version 1 of a machine file."""

    machine: Literal[1]
    name: str = Field(description="name of the machine, as recordings give it")
    title: str = Field("", description="what it is, for people")
    notes: tuple[str, ...] = Field((), description="remarks that are printed with its model in symbols")
    chain: tuple[str, ...] = Field(description="links from workpiece to tool; a prime: carries the workpiece")
    left_handed: bool = Field(False, description="whether the control counts X, Y and Z left-handed, against ISO 841")
    axes: dict[str, Axis] = Field(description="axes of the chain by letter")
    datum_axes: tuple[str, ...] = Field(
        (), description="linear axes in the order squareness refers to: the first is the datum; X, Y, Z where left out"
    )
    up: Literal["X", "Y", "Z"] = Field("Z", description="axis that points up, for sketches")
    workpiece: Vector = quantity("mm", "origin of the workpiece frame", (0.0, 0.0, 0.0))
    spindle: Spindle = Field(Spindle(), description="the spindle nose")
    tool: Tool = Field(Tool(), description="the tool, from its mount to its tip")

    @field_validator("axes")
    @classmethod
    def _right_handed(cls, axes: dict[str, Axis], info: ValidationInfo) -> dict[str, Axis]:
        """Refuses X, Y, Z that count left-handed, unless it is stated, or one counts a carriage's own motion.

        Pydantic leaves out of `info.data` what is not valid itself, and has said so.
        """
        three = [axes[letter] for letter in LETTERS if letter in axes]
        stated = info.data.get("left_handed", True) or any(a.errors_of == "carriage" for a in three)
        if len(three) < 3 or stated:
            return axes
        x, y, z = (a.direction or LETTERS[n] for n, a in zip(LETTERS, three, strict=True))
        if sum(x[i] * (y[i - 2] * z[i - 1] - y[i - 1] * z[i - 2]) for i in range(3)) < 0.0:
            turned = [
                n for n, a in zip(LETTERS, three, strict=True) if a.direction and a.direction["XYZ".index(n)] < 0.0
            ]
            raise ValueError(
                f"X, Y and Z count left-handed ({', '.join(turned) or 'their order'} against ISO 841). Turn the "
                "direction of one round, or, if the control counts so, state left_handed: true; an axis that counts "
                "the motion of the table itself states errors_of: carriage"
            )
        return axes

    @model_validator(mode="after")
    def _chain_holds_together(self) -> Machine:
        chain = self.chain
        if len(chain) < 3 or chain[0] != "workpiece" or chain[-1] != "tool":
            raise ValueError("chain runs from workpiece to tool, such as [workpiece, Y', bed, X, Z, spindle, tool]")
        if chain.count("bed") != 1:
            raise ValueError(f"chain names the bed once (found {chain.count('bed')} times)")
        links = [link.rstrip("'") for link in chain[1:-1]]
        doubled = sorted({link for link in links if links.count(link) > 1})
        if doubled:
            raise ValueError(f"chain names {', '.join(doubled)} more than once")
        bed = chain.index("bed")
        for place, link in enumerate(chain[1:-1], start=1):
            name = link.rstrip("'")
            if name in ("bed", "spindle"):
                continue
            if name not in self.axes:
                raise ValueError(f"chain names {link}, but axes has no {name}.{did_you_mean(name, self.axes)}")
            if link.endswith("'") != (place < bed):
                right = f"{name}'" if place < bed else name
                raise ValueError(
                    f"{link}: an axis that carries the {'workpiece' if place < bed else 'tool'} is written {right}"
                )
        unused = sorted(set(self.axes) - set(links))
        if unused:
            raise ValueError(f"axes {', '.join(unused)} are not in the chain")
        for name, axis in self.axes.items():
            if axis.direction is None and name[0] not in LETTERS and name[0] not in PARALLEL_AXIS:
                raise ValueError(f"axis {name} has no letter of ISO 841; give its direction")
        linear = {n for n, a in self.axes.items() if a.kind == "linear"}
        if self.datum_axes and (set(self.datum_axes) != linear or len(self.datum_axes) != len(linear)):
            raise ValueError(f"datum_axes lists every linear axis once ({', '.join(sorted(linear))})")
        return self

    def order(self) -> tuple[str, ...]:
        """Axes in the order of the chain, from workpiece to tool, without primes."""
        return tuple(n for n in (link.rstrip("'") for link in self.chain[1:-1]) if n not in ("bed", "spindle"))

    def side_moved_by(self, name: str) -> Literal["workpiece", "tool"]:
        """What an axis (or the spindle) moves."""
        links = [link.rstrip("'") for link in self.chain]
        return "workpiece" if links.index(name) < links.index("bed") else "tool"

    def linear_axes(self) -> tuple[str, ...]:
        """Linear axes: in the order of `datum_axes`, else by letter."""
        if self.datum_axes:
            return self.datum_axes
        return tuple(
            sorted((n for n, a in self.axes.items() if a.kind == "linear"), key=lambda n: ("XYZUVWPQR".find(n[0]), n))
        )

    def correcting_axes(self) -> tuple[str, ...]:
        """Linear axes that no rotary axis turns against the bed: a correction in them has a fixed direction."""
        links, rotary = [link.rstrip("'") for link in self.chain], set(self.rotary_axes())
        bed = links.index("bed")
        return tuple(
            a for a in self.linear_axes() if not rotary.intersection(links[min(i := links.index(a), bed) : max(i, bed)])
        )

    def rotary_axes(self) -> tuple[str, ...]:
        return tuple(sorted(n for n, a in self.axes.items() if a.kind == "rotary"))

    def direction(self, name: str) -> Vector:
        """Unit vector of an axis in machine coordinates."""
        own = self.axes[name].direction
        return LETTERS[PARALLEL_AXIS.get(name[0], name[0])] if own is None else own

    def mount(self) -> Vector:
        """Point the tool is measured from."""
        return self.spindle.position if self.tool.mount is None else self.tool.mount
