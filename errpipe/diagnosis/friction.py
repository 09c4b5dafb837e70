"""Friction that depends on direction: the drive force fitted with one law for both directions, and with one for each.

        force = mass a + damping v + friction tanh(v / sharpness) + offset                       same in both directions
        force = mass a + damping(way) v + friction(way) tanh(|v| / sharpness)                    separate by direction

The second law is accepted if it predicts held-out blocks of the recording better and a parameter differs
significantly between the directions. Intervals come from a block jackknife, because neighbouring rows are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from errpipe.diagnosis import model, units
from errpipe.diagnosis.case import Case
from errpipe.domain.diagnosis import Finding, FoundParameter
from errpipe.drivers.motion import is_rotary
from errpipe.terms import TERMS
from errpipe.terms.viscous_friction import ViscousFriction

SHARPNESS = (0.0, 0.0025, 0.008, 0.016, 0.024, 0.032, 0.048, 0.064)  # of the highest speed
BLOCKS = 40  # stretches of rows, resampled for standard errors
BETTER = 0.97  # ratio of held-out rms, two laws to one: threshold below which two laws are accepted
MAX_LOSS = 1.02  # ratio of held-out rms to that of the best sharpness, up to which another one widens the interval
SIGNIFICANT = 4.0  # standard errors by which a parameter must differ between the directions
PARTS = {kind.reports_as: kind.friction_part for kind in TERMS if kind.friction_part}


@dataclass(frozen=True)
class Fitted:
    """Coefficients, standard errors, differences (last two pairs), and rms on held-out blocks."""

    value: np.ndarray
    covariance: np.ndarray
    held_out: float

    def differ(self, one: int, other: int) -> bool:
        """Do two coefficients differ by more than SIGNIFICANT standard errors?"""
        c = self.covariance
        sd = np.sqrt(max(c[one, one] + c[other, other] - 2 * c[one, other], 1e-300))
        return bool(abs(self.value[one] - self.value[other]) > SIGNIFICANT * sd)


@dataclass(frozen=True)
class ByDirection:
    """A friction law per direction: damping and friction, forwards and backwards, in the units of axis and response.

    response: N or N m; rotary: damping per deg/s, else per m/s.
    """

    axis: str
    column: str
    law: Fitted
    alike: Fitted
    response: str = "N"
    rotary: bool = False

    def _in_units(self, name: str, k: int, unit: str) -> FoundParameter:
        unit, factor = units.reported(unit, self.response, self.rotary)
        value, reach = self.law.value[k] * factor, 1.96 * model.WIDER * np.sqrt(self.law.covariance[k, k]) * factor
        ends = float(value - reach), float(value + reach)
        return FoundParameter(name=name, value=float(value), unit=unit, ci95=ends)

    def damping(self) -> tuple[FoundParameter, ...]:
        return tuple(self._in_units(f"damping_{way}", k, "N s/m") for way, k in (("forward", 1), ("backward", 2)))

    def force(self) -> tuple[FoundParameter, ...]:
        return tuple(self._in_units(f"force_{way}", k, "N") for way, k in (("forward", 3), ("backward", 4)))

    def sentence(self) -> str:
        both = (*self.damping(), *self.force())
        values = [f"{p.value:.3g} ({p.ci95[0]:.3g} to {p.ci95[1]:.3g}) {p.unit}" for p in both]
        return (
            f"Friction differs by direction: {values[0]} forwards and {values[1]} backwards, with a dry part of "
            f"{values[2]} and {values[3]}; on held-out stretches the force is then met to {self.law.held_out:.3g} "
            f"{self.response} rms instead of {self.alike.held_out:.3g} with one law for both directions."
        )


def by_direction(case: Case) -> ByDirection | None:
    """The law of each direction if they differ, from the recorded force; None if not, or if this is undecidable."""
    axis = case.pair.component[2:]
    velocity, acceleration = (case.recording.name(role, axis=axis) for role in ("velocity", "acceleration"))
    if not case.pair.component.startswith("F_") or velocity is None or acceleration is None:
        return None
    rows = case.pair.rows
    force = case.recording.array(case.pair.error)[rows]
    v, a = (case.recording.array(name)[rows] for name in (velocity, acceleration))
    forward, back = (v > 0).astype(float), (v < 0).astype(float)
    if min(forward.sum(), back.sum()) < 10 * BLOCKS:
        return None
    best, laws, fastest = None, [], float(np.quantile(np.abs(v), 0.999))
    for sharpness in (fastest * s for s in SHARPNESS):
        dry = np.sign(v) if sharpness == 0 else np.tanh(v / sharpness)
        mass, drag = 1e-3 * a, 1e-3 * v
        law = fitted(np.column_stack([mass, drag * forward, drag * back, dry * forward, dry * back]), force)
        laws.append(law)
        if best is None or law.held_out < best.law.held_out:
            single_law = fitted(np.column_stack([mass, drag, dry, np.ones(v.size)]), force)
            best = ByDirection(axis, velocity, law, single_law, case.pair.unit, is_rotary(case.recording, axis))
    assert best is not None
    best = replace(best, law=widened(best.law, laws))
    differs = best.law.differ(1, 2) or best.law.differ(3, 4)
    drives = best.law.value[1:3] < -2.0 * np.sqrt(np.diag(best.law.covariance)[1:3])  # no friction speeds an axis up
    return best if differs and not drives.any() and best.law.held_out < BETTER * best.alike.held_out else None


def widened(law: Fitted, others: list[Fitted]) -> Fitted:
    """The law with its covariance widened by the spread over other sharpnesses that predict nearly as well."""
    differences = np.stack([o.value - law.value for o in others if o.held_out < MAX_LOSS * law.held_out])
    return replace(law, covariance=law.covariance + differences.T @ differences / len(differences))


def fitted(columns: np.ndarray, y: np.ndarray) -> Fitted:
    """Least squares with a block jackknife: covariance and held-out rms."""
    block = np.arange(y.size) * BLOCKS // y.size
    G = np.stack([columns[block == k].T @ columns[block == k] for k in range(BLOCKS)])
    g = np.stack([columns[block == k].T @ y[block == k] for k in range(BLOCKS)])
    whole = G.sum(axis=0) + 1e-12 * np.trace(G.sum(axis=0)) * np.eye(columns.shape[1])
    value = np.linalg.solve(whole, g.sum(axis=0))
    without = np.stack([np.linalg.solve(whole - G[k], g.sum(axis=0) - g[k]) for k in range(BLOCKS)])
    deviations = without - without.mean(axis=0)
    residual = y - np.einsum("nk,nk->n", columns, without[block])
    return Fitted(value, (BLOCKS - 1) / BLOCKS * deviations.T @ deviations, float(np.sqrt(np.mean(residual**2))))


def with_directional_law(findings: list[Finding], law: ByDirection, held: set[str]) -> list[Finding]:
    """The findings once friction is known to depend on direction; held: effects that the simulation contains.

    Dry friction gets its two levels, and the damping of each direction is added if no viscous finding states it. A
    Stribeck part whose friction rises from standstill is an artefact of a single law for both directions: the
    damping of each direction replaces it.
    """
    out: list[Finding] = []
    kinds = [PARTS.get(f.effect) for f in findings]
    carried = "viscous" in kinds or any(
        k == "falling" and opposes_dry_friction(f, findings) for k, f in zip(kinds, findings, strict=True)
    )
    for f in findings:
        if PARTS.get(f.effect) == "dry":
            parameters = (*f.parameters, *law.force(), *(() if carried else law.damping()))
            f = f.model_copy(update={"parameters": parameters, "says": f"{f.says} {law.sentence()}"})
        elif PARTS.get(f.effect) == "viscous":
            # a common damping is redundant if each direction has its own, except as the error of one in the simulation
            known = (f.parameters, f"{f.says} ") if f.effect in held else ((), "")
            f = f.model_copy(update={"parameters": (*known[0], *law.damping()), "says": known[1] + law.sentence()})
        elif PARTS.get(f.effect) == "falling" and opposes_dry_friction(f, findings):
            term = ViscousFriction(axis=law.axis, column=law.column)
            f = Finding(
                effect=term.reports_as,
                confidence=f.confidence,
                drivers=(law.column,),
                parameters=law.damping(),
                says=law.sentence(),
                rms_um=f.rms_um,
                compensable=False,
                would_separate=f"run {law.axis} both ways at three constant speeds and compare the forces",
                term={"term": term.term, "axis": law.axis, "column": law.column},
            )
        out.append(f)
    return out


def opposes_dry_friction(stribeck: Finding, findings: list[Finding]) -> bool:
    """Does a Stribeck part have the opposite sign to the dry friction found with it? It then adds to the force."""
    dry = [f.parameters[0].value for f in findings if PARTS.get(f.effect) == "dry" and f.parameters]
    return bool(dry) and bool(stribeck.parameters) and stribeck.parameters[0].value * dry[0] < 0
