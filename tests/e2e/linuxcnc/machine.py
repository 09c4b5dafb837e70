"""A machining centre that never existed: 21 errors and heat by full transforms; its table; its LinuxCNC set-up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.domain.machine import Machine
from errpipe.drivers.lowered import Lowered
from errpipe.kinematics import compensation, synthesis
from errpipe.kinematics.chain import Chain, compile_chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.simulation import metrology
from errpipe.targets.linuxcnc_hal import JOINTS, SHIFT, LinuxcncHal
from errpipe.targets.linuxcnc_screw import LinuxcncScrew
from tests.e2e.linuxcnc import session

AXES = "XYZ"
TRAVEL = {"X": (0.0, 500.0), "Y": (0.0, 400.0), "Z": (-300.0, 0.0)}
CYCLE = 0.001  # s
THERMAL_CYCLE = 0.005  # s; heat moves some two hundred times faster here than in a workshop, and so does this cycle
TOOL = 120.0  # mm
COLD, SCREW_HOT, SPINDLE_HOT = 20.0, 30.0, 34.0
SCREW_SENSOR, SPINDLE_SENSOR = 6.0, 3.0  # s, time constants of the sensors' temperatures
SCREW_LAG, SPINDLE_LAG = 4.0, 2.5  # s, of the deviations behind the sensors
EXPANSION, GROWTH = 0.011, -2.5  # um/mm/K; um/K
LOST = 3.0  # um, half the lost motion of X
THRESHOLD = 0.002  # mm of travel until the direction has turned


@cache
def chain() -> Chain:
    """Work on X and Y, tool on Z: 21 components, and the spindle's growth."""
    axes = {
        "X": {"kind": "linear", "travel": TRAVEL["X"], "reference": (250, 200, -400)},
        "Y": {"kind": "linear", "travel": TRAVEL["Y"], "reference": (250, 200, -450)},
        "Z": {"kind": "linear", "travel": TRAVEL["Z"], "reference": (250, 0, 150), "datum": 0},
    }
    facts = {
        "machine": 1,
        "name": "closed-loop",
        "chain": ["workpiece", "X'", "Y'", "bed", "Z", "spindle", "tool"],
        "axes": axes,
        "workpiece": (0, 0, -400),
        "spindle": {"position": (250, 200, 0), "growth": True},
        "tool": {"length": TOOL},
    }
    return compile_chain(Machine.model_validate(facts))


@cache
def errors() -> MachineErrors:
    """The 21 geometric errors, smooth and random; the spindle's growth is left to the heat."""
    values = {n: v for n, v in metrology.smooth_machine(chain(), 5).items() if n not in ("X0S", "Y0S", "Z0S")}
    assert len(values) == 21
    return MachineErrors.of(chain(), values)


@cache
def table() -> t.CompensationTable:
    """What is compiled from it: 21 components, lost motion of X, a warm screw and a growing spindle."""
    pairs = dict(compensation.lowered(errors()))
    screw = d.Lag(of=d.above("T screw", COLD), tau_up=SCREW_LAG, tau_down=SCREW_LAG)
    spindle = d.Lag(of=d.above("T spindle", COLD), tau_up=SPINDLE_LAG, tau_down=SPINDLE_LAG)
    side = d.Direction(axis="X", threshold=THRESHOLD)
    pairs["EXX"] += (
        Lowered(screw, "X", lambda x: EXPANSION * x),
        Lowered(side, None, lambda x: np.full(np.shape(x), -LOST)),
    )
    pairs["Z0S"] = (Lowered(spindle, None, lambda x: np.full(np.shape(x), GROWTH)),)
    inputs = [
        t.TableInput(name=a, kind="position", axis=a, unit="mm", low=lo - 20, high=hi + 20, default=0.0)
        for a, (lo, hi) in TRAVEL.items()
    ]
    inputs += [
        t.TableInput(
            name=n,
            kind="sensor",
            unit="degC",
            low=-20,
            high=90,
            default=COLD,
            max_rate=50.0,
            hold_s=1.0,
            valid=(15.0, 40.0),
            margin=5.0,
        )
        for n in ("T screw", "T spindle")
    ]
    inputs += [t.TableInput(name="tool_length", kind="tool", unit="mm", low=0, high=400, default=TOOL)]
    inputs += [
        t.TableInput(name=f"tool_offset_{a}", kind="tool", unit="mm", low=-300, high=300, default=0) for a in AXES
    ]
    outputs = compensation.outputs(chain(), used=tuple(pairs))
    return tables.compile_table(
        [tables.ComponentSource(n, chain().unit(n), p) for n, p in pairs.items()],
        inputs=inputs,
        outputs=outputs,
        travel=TRAVEL,
        error_bound=0.01,
        position_cycle_s=CYCLE,
        thermal_cycle_s=THERMAL_CYCLE,
        ramp_s=0.2,
        machine="closed-loop",
    )


@dataclass(frozen=True)
class Record:
    """Every servo cycle of a run. command, motor: mm, (n, 3); screw, spindle: degC; the last two from the component."""

    number: np.ndarray
    command: np.ndarray
    motor: np.ndarray
    screw: np.ndarray
    spindle: np.ndarray
    heartbeat: np.ndarray
    status: np.ndarray
    facts: dict

    def direction(self, axis: int = 0) -> np.ndarray:
        """+1 or -1 per cycle: turned once the axis went `THRESHOLD` against it."""
        out, side, furthest = np.ones(len(self.command)), 1.0, -np.inf
        for k, x in enumerate(self.command[:, axis]):
            if side * x >= side * furthest or not np.isfinite(furthest):
                furthest = x
            elif side * (furthest - x) >= THRESHOLD:
                side, furthest = -side, x
            out[k] = side
        return out

    def heat(self) -> tuple[np.ndarray, np.ndarray]:
        """Rises that the screw and the spindle feel, K: first-order behind the sensors, cold at the start."""
        return lag(self.screw - COLD, SCREW_LAG), lag(self.spindle - COLD, SPINDLE_LAG)

    def deviation(self, every: int = 1) -> np.ndarray:
        """Where the tool really is against where the program wants it, um, by full transforms, (n, 3)."""
        screw, spindle = self.heat()
        q = np.ascontiguousarray(self.motor[::every])
        comps = errors().at(q)
        comps[:, chain().index("EXX")] += (EXPANSION * q[:, 0] * screw[::every]) - LOST * self.direction()[::every]
        comps[:, chain().index("Z0S")] += GROWTH * spindle[::every]
        is_, wanted = synthesis.actual_pose(chain(), q, comps), synthesis.ideal_pose(chain(), self.command[::every])
        return 1e3 * (is_[:, 0] - wanted[:, 0])

    def second_order(self, every: int = 1) -> np.ndarray:
        """What a first-order synthesis cannot know, at most, um per cycle."""
        q = np.ascontiguousarray(self.motor[::every])
        return synthesis.second_order_bound(chain(), q, errors().at(q))

    def held(self, every: int = 1) -> np.ndarray:
        """What heat changes while the table holds its thermal nodes (one cycle) and their input (another), um, (n, 3).

        That is how old a thermal node can be; no bound of a profile speaks of it.
        """
        screw, spindle = (np.abs(np.gradient(rise, CYCLE)) * 2 * THERMAL_CYCLE for rise in self.heat())
        out = np.zeros((len(self.command), 3))
        out[:, 0] = EXPANSION * np.abs(self.motor[:, 0]) * screw
        out[:, 2] = abs(GROWTH) * spindle
        return out[::every]

    def moving(self) -> slice:
        """From the first motion on."""
        return slice(int(np.argmax(np.abs(self.command - self.command[0]).max(axis=1) > 0.001)), None)


def lag(u: np.ndarray, tau: float) -> np.ndarray:
    """First-order response to u held over each cycle, from rest."""
    keep = np.exp(-CYCLE / tau)
    return lfilter([0.0, 1.0 - keep], [1.0, -keep], u)


CORE = """loadrt trivkins coordinates=XYZ
loadrt motmod servo_period_nsec=1000000 num_joints=3
loadrt lowpass count=2
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf lowpass.0 servo-thread
addf lowpass.1 servo-thread
"""

RECORDER = """loadrt scale names=nm-x,nm-y,nm-z
loadrt sum2 names=moved-x,moved-y,moved-z,wanted-x,wanted-y,wanted-z
loadrt sampler depth=30000 cfg=ffffffffuu
net screw lowpass.0.out => sampler.0.pin.6
net spindle lowpass.1.out => sampler.0.pin.7
net beat errpipe.heartbeat => sampler.0.pin.8
net status errpipe.status => sampler.0.pin.9
"""
PINS = {
    "T screw": "net screw => errpipe.in-t-screw",
    "T spindle": "net spindle => errpipe.in-t-spindle",
    "tool_length": f"setp errpipe.in-tool-length {TOOL}",
}
PINS |= {f"tool_offset_{a}": f"setp errpipe.in-tool-offset-{a.lower()} 0" for a in AXES}


def connections(way: str, made: t.CompensationTable) -> str:
    """HAL lines that put the simulated machine behind the joints and the recorder behind everything."""
    lines = [RECORDER, *(PINS[i.name] for i in made.inputs if i.name in PINS)]
    lines += [f"setp lowpass.{n}.in {COLD}\nsetp lowpass.{n}.load 1" for n in (0, 1)]
    for n, tau in enumerate((SCREW_SENSOR, SPINDLE_SENSOR)):
        lines.append(f"setp lowpass.{n}.gain {1 - np.exp(-CYCLE / tau):.12f}")
    corrected = {o.axis.lower() for o in made.outputs}
    for n, axis in enumerate(AXES.lower()):
        wanted, motor = f"wanted-{axis} joint.{n}.pos-cmd", f"motor-{axis} joint.{n}.motor-pos-cmd"
        if way == "shift":
            lines.append(f"net shifted-{axis} axis.{axis}.eoffset => wanted-{axis}.in1\nsetp wanted-{axis}.gain1 -1")
            lines.append(f"net errpipe-{axis}-position => wanted-{axis}.in0\naddf wanted-{axis} servo-thread")
            wanted = f"wanted-{axis} wanted-{axis}.out"
        elif axis in corrected:
            wanted, motor = f"errpipe-{axis}-position", f"errpipe-{axis}-command"
        # The simulated drive follows without error, so what it measures is its command.
        measured = f"joint.{n}.motor-pos-fb" if motor.startswith("motor") else f"errpipe.measured-{axis}"
        lines.append(f"net {motor} => {measured} moved-{axis}.in0")
        lines.append(f"net {wanted} => moved-{axis}.in1 sampler.0.pin.{n}")
        lines.append(f"setp moved-{axis}.gain1 -1\nsetp nm-{axis}.gain 1e6")  # halsampler prints six decimals
        lines.append(f"net moved-{axis} moved-{axis}.out => nm-{axis}.in")
        lines.append(f"net nm-{axis} nm-{axis}.out => sampler.0.pin.{3 + n}")
        lines.append(f"addf moved-{axis} servo-thread\naddf nm-{axis} servo-thread")
    lines.append("addf sampler.0 servo-thread")
    if way in ("off", "screw"):
        lines.append("unlinkp errpipe.enable")
    return "\n".join(lines) + "\n"


def ini(way: str, screws: tuple[str, ...], home: float = 0.0) -> str:
    """The controller's own file; with the screw files where they are to be used. home: of X, where it stands."""
    traj = "DEFAULT_LINEAR_VELOCITY = 500\nMAX_LINEAR_VELOCITY = 1500\nDEFAULT_LINEAR_ACCELERATION = 10000\n"
    parts = [session.ini(AXES, SHIFT if way == "shift" else JOINTS, traj)]
    for n, axis in enumerate(AXES):
        low, high = TRAVEL[axis]
        limits = f"MIN_LIMIT = {low - 1}\nMAX_LIMIT = {high + 1}\nMAX_VELOCITY = 1000\nMAX_ACCELERATION = 10000\n"
        parts.append(f"[AXIS_{axis}]\n{limits}" + ("OFFSET_AV_RATIO = 0.2\n" if way == "shift" else ""))
        parts.append(
            f"[JOINT_{n}]\nTYPE = LINEAR\nHOME = {0 if n else home}\nHOME_SEQUENCE = 0\n{limits}FERROR = 0.001\n"
        )
        if f"{axis.lower()}.comp" in screws:
            parts.append(f"COMP_FILE = {axis.lower()}.comp\nCOMP_FILE_TYPE = 1\n")
    return "".join(parts)


def lattice(points: int = 3) -> str:
    """A program that visits a lattice in serpentines: X from both sides, a short rest at each point."""
    nodes = [np.linspace(lo + 5, hi - 5, points) for lo, hi in TRAVEL.values()]
    places = []
    for k, z in enumerate(nodes[2]):
        for j, y in enumerate(nodes[1][:: -1 if k % 2 else 1]):
            places += [(x, y, z) for x in nodes[0][:: -1 if (j + k) % 2 else 1]]
    lines = [f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f}\nG4 P0.06" for x, y, z in places]
    return "\n".join(["G21 G90 G94 G61", "F48000", *lines, "G0 X0 Y0 Z0", "M2", ""])


def run(
    folder: Path,
    way: str,
    made: t.CompensationTable | None = None,
    program: str = "",
    least_s: float = 0.0,
    read: tuple[str, ...] = (),
    stops: int = 0,
    home: float = 0.0,
) -> Record:
    """One session: way is off, screw, hal or shift. Raises AssertionError with LinuxCNC's words where it fails."""
    made = made or table()
    screws = LinuxcncScrew.write(made) if way == "screw" else {}
    files = {
        "sim.ini": ini(way, tuple(screws), home),
        "core.hal": CORE + session.IO,
        "connect.hal": connections(way, made),
        "program.ngc": program or lattice(),
        **LinuxcncHal.write(made),
        **screws,
    }
    session.write(
        folder,
        files,
        program_s=120,
        least_s=least_s,
        read=read,
        stops=stops,
        stop_pins=["joint.0.motor-pos-cmd" if way == "shift" else "errpipe.command-x"],
        go_on=way == "shift",
        heat={"lowpass.0.load": 0, "lowpass.1.load": 0, "lowpass.0.in": SCREW_HOT, "lowpass.1.in": SPINDLE_HOT},
        cool={"lowpass.0.in": COLD, "lowpass.1.in": COLD},
    )
    facts, rows = session.run(folder, 120 + 2 * least_s)
    command = rows[:, 1:4]
    return Record(
        number=rows[:, 0].astype(int),
        command=command,
        motor=command + 1e-6 * rows[:, 4:7],
        screw=rows[:, 7],
        spindle=rows[:, 8],
        heartbeat=rows[:, 9].astype(int),
        status=rows[:, 10].astype(int),
        facts=facts,
    )
