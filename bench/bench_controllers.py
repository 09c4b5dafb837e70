"""What a cycle costs inside a controller: python -m bench.bench_controllers.

The table of `bench_tables` (21 components, 8 lagged sensors, synthesis) as LinuxCNC's HAL component in a 1 kHz thread;
HAL counts the clocks of every call. Between two calls the caches belong to others, so that a call costs several times
what `bench_tables` finds for the C runtime in a loop (under 1 us is the aim there; Numba against C stands there too).
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from bench.bench_tables import machine
from bench.figure import Figure, main
from errpipe.tables import bounds
from errpipe.targets.linuxcnc_hal import COMPONENT, LinuxcncHal
from tests.e2e.linuxcnc import session

CYCLES = 5000
AIM_NS = 5000.0  # of the usual call, caches cold: 4 % of a 125 us cycle
HAL = """loadrt threads name1=servo-thread period1=1000000
loadrt siggen num_chan=3
loadrt errpipe
loadrt sampler depth=8000 cfg=s
addf siggen.0.update servo-thread
addf siggen.1.update servo-thread
addf siggen.2.update servo-thread
addf errpipe servo-thread
addf sampler.0 servo-thread
net x siggen.0.triangle => errpipe.in-x
net y siggen.1.triangle => errpipe.in-y
net z siggen.2.triangle => errpipe.in-z
net clocks errpipe.time => sampler.0.pin.0
setp errpipe.enable 1
"""


def clocks(folder: Path) -> np.ndarray:
    """Clocks of each call of the component, shape (CYCLES,)."""
    lines = [HAL]
    for n, hertz in enumerate((1.0, 1.37, 0.71)):
        lines += [f"setp siggen.{n}.{k} {v}" for k, v in {"amplitude": 290, "offset": 300, "frequency": hertz}.items()]
    lines += [f"setp errpipe.in-t{n} {21 + n}" for n in range(8)]
    (folder / "bench.hal").write_text("\n".join(lines) + "\n")
    env = session.environment(folder)
    if session.quiet(["halcmd", "-f", "bench.hal"], env, folder, 30) != 0:
        raise RuntimeError(session.said(folder))
    session.quiet(["halcmd", "start"], env, folder, 10)
    with (folder / "out.txt").open("w") as out:
        command = ["timeout", "60", "halsampler", "-c", "0", "-n", str(CYCLES)]
        subprocess.run(command, stdout=out, env=env, cwd=folder, stdin=subprocess.DEVNULL, check=True)
    return np.loadtxt(folder / "out.txt")[100:]  # without the first calls, which fill the caches


def bench_hal_component() -> dict[str, float]:
    """21 components and 8 lagged sensors in LinuxCNC's servo thread, ns per cycle."""
    table = machine(thermal=True)
    with session.alone() as folder:
        (folder / COMPONENT).write_text(LinuxcncHal.write(table)[COMPONENT])
        module = session.install(folder / COMPONENT)
        try:
            measured = clocks(folder)
        finally:
            module.unlink()
    mhz = float(re.search(r"cpu MHz\s*:\s*([\d.]+)", Path("/proc/cpuinfo").read_text())[1])
    ns = 1e3 * measured / mhz
    usual = float(np.median(ns))
    return {
        "cycle_ns": usual,
        "cycle_ns_99.9_percent": float(np.quantile(ns, 0.999)),
        "operations": float(bounds.cost(table)[0].operations),
    }


def figures() -> list[Figure]:
    """The usual and the slow call; nothing where LinuxCNC is not there."""
    if session.missing():
        print(f"  skipped: {session.missing()}")
        return []
    timings = bench_hal_component()
    return [
        Figure("cycle in LinuxCNC's servo thread", timings["cycle_ns"], "ns", aim=AIM_NS),
        Figure("the same, 99.9 %", timings["cycle_ns_99.9_percent"], "ns"),
        Figure("operations of the table, from its list", timings["operations"], "1"),
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
