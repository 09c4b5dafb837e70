"""Residual volumetric error of a machine after compensation by an identification.

The true error of a simulated machine is known: the residual is true minus predicted error, by full transforms, at
positions that no test measured. The workpiece's datum absorbs a rigid shift and rotation of the whole part, so both
are removed before and after. For a real machine only the standard error of the prediction is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from statistics import NormalDist
from typing import Any

import numpy as np

from errpipe.domain.components import parse
from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.errors import MachineErrors, interpolated
from errpipe.kinematics.identify import Identified

PLACES, SEED = 400, 77  # random positions at which a residual is evaluated; no test draws from this seed
# Positions at which the posterior covariance of a compensation is evaluated, mirrored. At 60 random ones the components
# used for the export decision overfitted those places: CMM, circles and diagonals, seeds 301 to 320, 3 of 24 exports
# made an axis worse (by up to 0.04 um); at these none of 31.
JUDGED, JUDGED_SEED = 400, 78
PIECE = 500  # positions per block of the covariance, which bounds memory
# Largest allowed probability that the machine, or an axis of it, gets worse. A campaign passes hundreds of axes, and at
# 0.01 one got worse (five axes by R-test, seed 20 of `trials.volumetric`, X 18.4 -> 19.2 um, stated 0.004).
MAX_HARM_PROBABILITY = 0.002
# Components are left out until no axis exceeds this probability, where they can be: with 95 % none of 100 axes gets
# worse (Bonferroni: 0.05 / 100). At 0.002 the same X got worse once more (19.2 -> 20.6 um, stated 0.0006).
AIMED_HARM_PROBABILITY = 0.0005
TRUTH_POINTS = 401  # of a simulated component over the travel, as `truth.json` holds it

Field = Callable[[np.ndarray], np.ndarray]  # axis positions (n, axes) -> deviation (n, 3) um


@dataclass(frozen=True)
class Remaining:
    """before, after: deviation fields of the simulated machine, without the workpiece's pose; rms and largest, um."""

    before: Field
    after: Field
    figures: dict[str, float]


def places(chain: Chain, count: int = PLACES, seed: int = SEED) -> np.ndarray:
    """Random axis positions over the whole travel, shape (count, axes)."""
    rng = np.random.default_rng(seed)
    return rng.uniform(chain.travel[:, 0], chain.travel[:, 1], (count, len(chain.axes)))


def mirrored_places(chain: Chain, count: int, seed: int) -> np.ndarray:
    """Random axis positions with their mirror images at the middle of every travel, shape (count or a few more, axes).

    A field that is odd along an axis then has a mean of exactly zero: the workpiece's pose, fitted at random places
    only, would rotate a deviation in X and Y slightly into Z.
    """
    sides = np.array(list(product((1.0, -1.0), repeat=len(chain.axes))))
    base = places(chain, -(-count // len(sides)), seed) - chain.travel.mean(axis=1)
    return chain.travel.mean(axis=1) + (sides[:, None] * base).reshape(-1, len(chain.axes))


def of_truth(chain: Chain, truth: MachineErrors, model: MachineErrors) -> Remaining:
    """Error of the true machine before and after compensation by `model`, each minus its best-fitting rigid pose."""

    def true(q: np.ndarray) -> np.ndarray:
        return synthesis.exact(chain, q, truth.at(q))[:, :3]

    def residual(q: np.ndarray) -> np.ndarray:
        return true(q) - synthesis.first_order(chain, q, model.at(q))[:, :3]

    q = places(chain)
    before, after = (without_pose(chain, field, q) for field in (true, residual))
    figures = {}
    for name, field in (("before", before), ("after", after)):
        size = np.linalg.norm(field(q), axis=1)
        figures[f"{name}_rms_um"] = float(np.sqrt(np.mean(size**2)))
        figures[f"{name}_largest_um"] = float(size.max())
    return Remaining(before, after, figures)


def without_pose(chain: Chain, field: Field, q: np.ndarray) -> Field:
    """A field minus the rigid shift and rotation of the workpiece that fit it best at q (least squares)."""
    middle = synthesis.ideal_pose(chain, q)[:, 0].mean(axis=0)
    pose, *_ = np.linalg.lstsq(_pose_columns(chain, q, middle).reshape(-1, 6), field(q).ravel(), rcond=None)
    return lambda at: field(at) - _pose_columns(chain, at, middle) @ pose


def _pose_columns(chain: Chain, q: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Deviation of the tool point per shift (um) and turn (urad) of the workpiece about `middle`, (n, 3, 6)."""
    arm = (synthesis.ideal_pose(chain, q)[:, 0] - middle) * 1e-3
    turns = [np.cross(axis, arm) for axis in np.eye(3)]
    shifts = [np.broadcast_to(axis, arm.shape) for axis in np.eye(3)]
    return np.stack([*shifts, *turns], axis=2)


def spread(identified: Identified) -> Callable[[np.ndarray], np.ndarray]:
    """Size of the standard error of the predicted tool point at q, um, shape (n,)."""

    def size(q: np.ndarray) -> np.ndarray:
        parts = np.array_split(q, max(1, len(q) // PIECE))
        return np.concatenate([np.linalg.norm(identified.predict(p)[1], axis=1) for p in parts])

    return size


@dataclass(frozen=True)
class Expected:
    """Expected effect of a compensation by an identification, from its posterior, without the workpiece's pose.

    effect_rms_um: of the compensated part; left_rms_um: expected residual; harm: the probability that the machine is
    worse with it (rms over the travel). axes: the same of each linear axis. left_alone: components not compensated.
    """

    effect_rms_um: float
    left_rms_um: float
    harm: float
    axes: Mapping[str, Expected]
    left_alone: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """As JSON values."""
        figures = {"effect_rms_um": self.effect_rms_um, "left_rms_um": self.left_rms_um, "probability_worse": self.harm}
        if not self.axes:
            return figures
        axes = {name: axis.document() for name, axis in self.axes.items()}
        return figures | {"axes": axes, "left_alone": list(self.left_alone)}


def expected(identified: Identified) -> Expected:
    """Expected benefit of a compensation from the posterior, if no reading can be held out.

    With m the identified field, c its compensated part and the true one m + e, e ~ N(0, S), compensation gives
    |m + e - c| instead of |m + e|. It is worse if 2 c.e < |c|^2 - 2 c.m, i.e. with probability
    Phi((|c|^2 / 2 - c.m) / sqrt(c'S c)). A component that no reading observes enters S with its prior variance, so the
    residual may exceed the correction; `_not_harmful` then excludes components. If only positioning was measured
    (a screw compensation), it is evaluated along its own line, so the others count neither before nor after.
    """
    chain, prior = identified.model.chain, identified.model.prior
    q = mirrored_places(chain, JUDGED, JUDGED_SEED)
    count = len(q)
    jac = synthesis.jacobian(chain, q)[:, :3]
    rows = (jac[:, :, prior.component] * identified.model.functions(q)[:, None, :]).reshape(3 * count, -1)
    read = np.unique(prior.component[identified.mean != 0.0])
    if all(parse(chain.components[c]).kind == "positioning" for c in read):
        rows = np.where(np.isin(prior.component, read), rows, 0.0)
    columns = _pose_columns(chain, q, synthesis.ideal_pose(chain, q)[:, 0].mean(axis=0))
    pose, _ = np.linalg.qr(columns.reshape(-1, 6))
    rows = (rows - pose @ (pose.T @ rows)).reshape(count, 3, -1)
    by_axis = np.einsum("nai,nip->anp", np.linalg.pinv(synthesis.linear_motion(chain, q)), rows)
    whole = by_axis.reshape(-1, rows.shape[2])
    kept = _not_harmful(identified, [whole, *by_axis])
    part = np.where(kept[prior.component], identified.mean, 0.0)
    names = chain.machine.correcting_axes()
    axes = {name: _expected(identified, part, own) for name, own in zip(names, by_axis, strict=True)}
    others = tuple(n for n, k in zip(chain.components, kept, strict=True) if not k)
    return replace(_expected(identified, part, whole, count), axes=axes, left_alone=others)


def _not_harmful(identified: Identified, fields: Sequence[np.ndarray]) -> np.ndarray:
    """Mask over the chain's components: those whose compensation makes none of the fields worse.

    Backward elimination: the component whose removal reduces the largest probability of harm most is removed first,
    until no field exceeds AIMED_HARM_PROBABILITY; if none is left then, the first subset within MAX_HARM_PROBABILITY.
    fields: rows (readings, parameters), um. All components if no subset passes, or if only fields within the noise of a
    reading exceed it: those axes are not compensated.
    """
    prior = identified.model.prior
    aimed, allowed = (NormalDist().inv_cdf(1.0 - p) for p in (AIMED_HARM_PROBABILITY, MAX_HARM_PROBABILITY))
    names = np.unique(prior.component)
    own = (prior.component[:, None] == names) * identified.mean[:, None]
    gain, size, doubt = [], [], []
    for rows in fields:
        of_each = rows @ own
        along = rows.T @ of_each
        gain.append(of_each.T @ (rows @ identified.mean))
        size.append(of_each.T @ of_each)
        doubt.append(along.T @ identified.covariance @ along)

    def margin(kept: np.ndarray, least: np.ndarray | float = 0.0) -> float:
        power, spread = (np.einsum("i,fij,j->f", kept, np.array(of), kept) for of in (size, doubt))
        sure = (np.array(gain) @ kept - 0.5 * power) / np.sqrt(np.maximum(spread, 1e-300))
        return float(np.where(power > least, sure, np.inf).min())

    kept, out = np.ones(names.size), np.ones(len(identified.model.chain.components), dtype=bool)
    least: np.ndarray | float = np.array([len(rows) * identified.noise**2 for rows in fields])
    sure = margin(kept, least)
    first, least = (kept, least) if sure >= allowed else (None, 0.0)
    while kept.any() and sure < aimed:
        fewer = {int(k): np.where(np.arange(names.size) == k, 0.0, kept) for k in np.flatnonzero(kept)}
        kept = fewer[max(fewer, key=lambda k: margin(fewer[k], least))]
        sure = margin(kept, least)
        first = kept if first is None and allowed <= sure < np.inf else first
    if sure < np.inf:  # infinite: nothing is compensated
        first = kept
    if first is not None:
        out[names] = (first > 0.0) | ~own.any(axis=0)  # a component of zero changes nothing
    return out


def _expected(identified: Identified, part: np.ndarray, rows: np.ndarray, count: int | None = None) -> Expected:
    """part: parameters that are compensated; rows (readings, parameters) of a field in um; count: places that its
    squares are the mean over.
    """
    count = len(rows) if count is None else count
    field, rest = rows @ part, rows @ (identified.mean - part)
    power = float(field @ field)
    deviation_along = float(np.sqrt(max(field @ (rows @ (identified.covariance @ (rows.T @ field))), 0.0)))
    trace = float(np.einsum("ij,jk,ik->", rows, identified.covariance, rows, optimize=True))
    gain = power / 2 + float(field @ rest)
    harm = NormalDist().cdf(-gain / deviation_along) if deviation_along > 0.0 else 0.0
    left = math.sqrt(max(trace + float(rest @ rest), 0.0) / count)
    return Expected(math.sqrt(power / count), left, harm, {})


def truth_document(chain: Chain, values: Mapping[str, Any]) -> dict[str, Any]:
    """The components of a simulated machine as JSON values: curves over the travel, constants; um and urad."""
    curves, constants = {}, {}
    for c, name in enumerate(chain.components):
        value = values.get(name, 0.0)
        if chain.drives[c] < 0:
            constants[name] = float(value)
            continue
        low, high = chain.travel[chain.drives[c]]
        p = np.linspace(low, high, TRUTH_POINTS)
        curve = value(p) if callable(value) else np.full(TRUTH_POINTS, float(value))
        curves[name] = {"start": float(low), "step": float(p[1] - p[0]), "value": [round(float(v), 5) for v in curve]}
    return {"truth": 1, "machine": chain.machine.name, "curves": curves, "constants": constants}


def truth(chain: Chain, document: Mapping[str, Any]) -> MachineErrors | None:
    """The simulated machine of `truth_document`; None if it is another machine."""
    if document.get("machine") != chain.machine.name:
        return None
    values: dict[str, Any] = {n: v for n, v in document["constants"].items() if n in chain.components}
    for name, curve in document["curves"].items():
        if name in chain.components:
            values[name] = interpolated(curve)
    return MachineErrors.of(chain, values, 401)
