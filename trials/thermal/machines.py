"""Three kinds of thermal machine that share no code with the model families.

    plate    a frame in section: two-dimensional finite volumes, spindle and motor heat, films that grow with speed
    rod      a screw between two bearings, heated where its nut travels that day; the housing follows the room
    network  six to ten lumped bodies joined at random

Each is linear between changes of the film: theta' = A theta + B u, marched exactly over a step in which the inputs are
held (matrix exponential). Lengths in m, conductances in W/K, capacities in J/K, rises in K above 20 degC.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

Array = np.ndarray
Rng = np.random.Generator


@dataclass
class Machine:
    """Bodies with conductances, what heats them and what the tool point makes of their temperatures.

    joints: conductances between bodies (n, n); films: conductances to the room (n,) at rest; windy: how much the films
    grow at full speed (n,); heat: W per source at full work, shape (n, sources); growth: um of deviation per K of each
    body (n,); nodes: bodies that carry a sensor.
    """

    kind: str
    capacity: Array
    joints: Array
    films: Array
    windy: Array
    heat: Array
    growth: Array
    nodes: Array
    room_growth: float = 0.0

    def march(self, step: float, work: Array, speed: Array, room: Array) -> Array:
        """Temperatures in degC, shape (rows, n); work: (rows, sources) in 0..1; starts settled at the first room."""
        levels = np.round(speed * 4) / 4  # the film at quarters of the full speed
        steps = {level: self._step(step, level) for level in np.unique(levels).tolist()}
        theta = np.full(self.capacity.size, room[0])
        out = np.empty((room.size, theta.size))
        for i in range(room.size):
            out[i] = theta
            keep, gain_heat, gain_room = steps[float(levels[i])]
            theta = keep @ theta + gain_heat @ work[i] + gain_room * room[i]
        return out

    def _step(self, step: float, speed: float) -> tuple[Array, Array, Array]:
        films = self.films * (1 + self.windy * speed)
        flow = self.joints - np.diag(self.joints.sum(axis=1) + films)
        a = flow / self.capacity[:, None]
        n, sources = self.heat.shape
        inputs = np.hstack([self.heat / self.capacity[:, None], (films / self.capacity)[:, None]])
        block = np.zeros((n + sources + 1, n + sources + 1))
        block[:n, :n], block[:n, n:] = a * step, inputs * step
        whole = expm(block)
        return whole[:n, :n], whole[:n, n : n + sources], whole[:n, -1]


def plate(rng: Rng) -> Machine:
    """A frame in section, 7 by 5 cells: spindle at the top, motor at one side, bending by the difference of sides."""
    rows, cols = 7, 5
    n = rows * cols
    height, width = rng.uniform(0.8, 2.0), rng.uniform(0.3, 0.7)
    wall = rng.uniform(0.02, 0.05)
    cell = np.array([height / rows, width / cols])
    conductivity = rng.uniform(40, 60)
    joints = np.zeros((n, n))
    for r in range(rows):
        for c in range(cols):
            for r2, c2, along in ((r + 1, c, 0), (r, c + 1, 1)):
                if r2 < rows and c2 < cols:
                    across = cell[1 - along] * wall * 20  # ribs: the section is far from solid
                    g = conductivity * across / cell[along]
                    joints[r * cols + c, r2 * cols + c2] = joints[r2 * cols + c2, r * cols + c] = g
    capacity = np.full(n, 7200 * 460 * cell.prod() * wall * 20)
    edge = np.array([(r in (0, rows - 1)) + (c in (0, cols - 1)) for r in range(rows) for c in range(cols)])
    films = rng.uniform(6, 12) * cell.mean() * (0.3 + edge) * rng.uniform(0.8, 1.2, n)
    heat = np.zeros((n, 2))
    heat[(rows - 1) * cols + cols // 2, 0] = rng.uniform(150, 500)
    heat[int(rng.integers(1, rows - 1)) * cols, 1] = rng.uniform(50, 300)
    windy = np.zeros(n)
    windy[-cols:] = rng.uniform(0, 2.5)
    u = np.tile(np.linspace(-1, 1, cols), rows)
    growth = 11.5 * height * (np.full(n, 1 / n) * rng.uniform(0.5, 1.0) + u / n * rng.uniform(-1.5, 1.5))
    nodes = rng.choice(n, int(rng.integers(3, 6)), replace=False)
    return Machine("plate", capacity, joints, films, windy, heat, growth, nodes)


def rod(rng: Rng) -> Machine:
    """A screw of 20 cells between two bearings, heated by the nut where it works that day; bearings heat its ends."""
    n = 22  # 20 cells and two housings
    length, radius = rng.uniform(0.5, 1.6), rng.uniform(0.012, 0.03)
    section, piece = np.pi * radius**2, length / 20
    joints = np.zeros((n, n))
    for i in range(19):
        joints[i, i + 1] = joints[i + 1, i] = 45 * section / piece
    joints[0, 20] = joints[20, 0] = rng.uniform(1, 6)
    joints[19, 21] = joints[21, 19] = rng.uniform(1, 6)
    capacity = np.r_[np.full(20, 7800 * 470 * section * piece), 500 * rng.uniform(8, 40, 2)]
    films = np.r_[np.full(20, rng.uniform(12, 25) * 2 * np.pi * radius * piece), rng.uniform(1, 4, 2)]
    windy = np.r_[np.full(20, rng.uniform(0.5, 3)), np.zeros(2)]
    heat = np.zeros((n, 4))
    for k, centre in enumerate((0.3, 0.7)):  # two strokes: the nut works here or there
        heat[:20, k] = np.exp(-0.5 * ((np.linspace(0, 1, 20) - centre) / 0.12) ** 2)
        heat[:, k] *= rng.uniform(20, 70) / heat[:, k].sum()
    heat[20, 2], heat[21, 3] = rng.uniform(10, 60), rng.uniform(0, 30)
    growth = np.r_[np.full(20, 11.5 * piece), rng.uniform(-4, 1), 0.0]
    choice = np.r_[rng.choice(20, int(rng.integers(1, 3)), replace=False), 20, 21]
    return Machine("rod", capacity, joints, films, windy, heat, growth, choice, rng.uniform(-2, 2))


def network(rng: Rng) -> Machine:
    """Six to ten bodies of 2 to 200 kg joined at random, of which three to five carry a sensor."""
    n = int(rng.integers(6, 11))
    mass = np.exp(rng.uniform(np.log(2), np.log(200), n))
    joints = np.zeros((n, n))
    for i in range(1, n):  # a tree, so that all are joined, then a few more
        j = int(rng.integers(i))
        joints[i, j] = joints[j, i] = np.exp(rng.uniform(np.log(1), np.log(25)))
    for _ in range(n // 2):
        i, j = rng.choice(n, 2, replace=False)
        joints[i, j] = joints[j, i] = np.exp(rng.uniform(np.log(0.5), np.log(8)))
    films = mass**0.67 * rng.uniform(0.1, 0.4, n)
    heat = np.zeros((n, 3))
    for k, body in enumerate(rng.choice(n, 3, replace=False)):
        heat[body, k] = np.exp(rng.uniform(np.log(40), np.log(500)))
    growth = rng.normal(0, 1, n) * np.exp(rng.uniform(np.log(0.3), np.log(6), n))
    nodes = rng.choice(n, int(rng.integers(3, min(n, 6))), replace=False)
    return Machine("network", 460 * mass, joints, films, rng.uniform(0, 1.5, n), heat, growth, nodes)


KINDS: dict[str, Callable[[Rng], Machine]] = {"plate": plate, "rod": rod, "network": network}
