"""From error components to the deviation of tool against workpiece: exact, first order, Jacobian, remainder.

All take q (n, axes) in mm and deg and give um and urad in the workpiece's frame. `tip` is the tool tip with
all axes at zero (`Chain.tip`), shape (3,), (1, 3) or (n, 3); default: the machine file's tool.
"""

from __future__ import annotations

import numpy as np

from errpipe.kernels import volumetric as k
from errpipe.kinematics.chain import Chain


def exact(chain: Chain, q: np.ndarray, comps: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """Deviation by full homogeneous transforms, shape (n, 6)."""
    q, comps, tip = _rows(chain, q, comps, tip)
    return k.exact(*chain.factors, q, tip, comps)


def first_order(chain: Chain, q: np.ndarray, comps: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """Deviation linear in the components (screw theory), shape (n, 6)."""
    q, comps, tip = _rows(chain, q, comps, tip)
    return k.first_order(*chain.factors, q, tip, comps)


def jacobian(chain: Chain, q: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """d(deviation)/d(component), shape (n, 6, components): um/um, um/urad, urad/urad."""
    q, _, tip = _rows(chain, q, None, tip)
    return k.jacobian(*chain.factors, q, tip, len(chain.components))


def second_order_bound(chain: Chain, q: np.ndarray, comps: np.ndarray) -> np.ndarray:
    """Upper bound of |exact - first order| of the tool point, um, shape (n,)."""
    q, comps, tip = _rows(chain, q, comps, None)
    return k.second_order_bound(*chain.factors, q, tip, comps)


def remainder(chain: Chain, q: np.ndarray, comps: np.ndarray) -> dict[str, float]:
    """Second-order remainder at these poses: largest and rms distance of the tool point, and its bound, um."""
    difference = exact(chain, q, comps)[:, :3] - first_order(chain, q, comps)[:, :3]
    size = np.linalg.norm(difference, axis=1)
    return {
        "largest_um": float(size.max()),
        "rms_um": float(np.sqrt(np.mean(size**2))),
        "bound_um": float(second_order_bound(chain, q, comps).max()),
    }


def ideal_pose(chain: Chain, q: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """Ideal tool tip and tool axes in the workpiece frame, shape (n, 4, 3): tip (mm), then images of x, y, z."""
    q, _, tip = _rows(chain, q, None, tip)
    out = k.pose(*chain.factors, q, tip, np.empty((len(q), 0)))
    out[:, 0] -= np.asarray(chain.machine.workpiece)
    return out


def actual_pose(chain: Chain, q: np.ndarray, comps: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """Actual tool tip and tool axes in the workpiece frame, shape (n, 4, 3)."""
    q, comps, tip = _rows(chain, q, comps, tip)
    out = k.pose(*chain.factors, q, tip, comps)
    out[:, 0] -= np.asarray(chain.machine.workpiece)
    return out


def motion_jacobian(chain: Chain, q: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """d(tool point, tool orientation)/d(axis), shape (n, 6, axes): mm/mm, mm/deg, deg/mm, deg/deg."""
    q, _, tip = _rows(chain, q, None, tip)
    out = np.empty((len(q), 6, len(chain.axes)))
    none = np.empty((len(q), 0))
    for a in range(len(chain.axes)):
        step = np.zeros(len(chain.axes))
        step[a] = 1e-3
        up = k.pose(*chain.factors, q + step, tip, none)
        down = k.pose(*chain.factors, q - step, tip, none)
        out[:, :3, a] = (up[:, 0] - down[:, 0]) / 2e-3
        turn = np.einsum("nki,nkj->nij", up[:, 1:], down[:, 1:])
        out[:, 3, a], out[:, 4, a], out[:, 5, a] = (
            np.degrees(turn[:, i, j] - turn[:, j, i]) / 2 / 2e-3 for i, j in ((2, 1), (0, 2), (1, 0))
        )
    return out


def linear_motion(chain: Chain, q: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """Displacement of the tool point per displacement of each linear axis that corrects, shape (n, 3, axes)."""
    return motion_jacobian(chain, q, tip)[:, :3][:, :, chain.linear]


def _rows(chain: Chain, q: np.ndarray, comps: np.ndarray | None, tip: np.ndarray | None):
    q = np.ascontiguousarray(np.atleast_2d(np.asarray(q, dtype=float)))
    if q.shape[1] != len(chain.axes):
        raise ValueError(f"q has {q.shape[1]} columns; the axes are {', '.join(chain.axes)}")
    tip = chain.tip() if tip is None else np.atleast_2d(np.asarray(tip, dtype=float))
    tip = np.ascontiguousarray(np.broadcast_to(tip, (len(q), 3)))
    if comps is None:
        return q, None, tip
    comps = np.atleast_2d(np.asarray(comps, dtype=float))
    if comps.shape[1] != len(chain.components):
        raise ValueError(f"comps has {comps.shape[1]} columns; the machine has {len(chain.components)} components")
    return q, np.ascontiguousarray(np.broadcast_to(comps, (len(q), comps.shape[1]))), tip
