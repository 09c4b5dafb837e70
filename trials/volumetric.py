"""Is anything exported that makes a machine worse? Every measuring protocol on simulated machines of known truth.

python -m trials.volumetric [--seeds 20] [--first 1] [--machines vertical-centre,...] [--protocols diagonal,...]

Each machine is measured, identified, judged on the held-out measurements, and passed through the gate of
`export_volumetric`. What passes is compared with the true machine over the whole travel, in all and axis by axis. Ends
with 1 where something that passed is worse than nothing.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from errpipe import yamlfile
from errpipe.domain.machine import Machine
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, GateError
from errpipe.fitting.solve import one_thread
from errpipe.kinematics import identify, readings, residual_error, summary, synthesis
from errpipe.kinematics.chain import Chain, compile_chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.simulation import direct_records, measuring_runs, metrology
from errpipe.validation import machine as gate

MACHINES = Path(__file__).parents[1] / "examples" / "machines"
PROTOCOLS = ("direct", *measuring_runs.PROTOCOLS)
NOISE = 0.5  # um
ROUNDING = 1e-3  # um: of a table's own numbers
PLACES, SEED = 4000, 79  # places of the judge, mirrored; no other figure uses this seed


@dataclass(frozen=True)
class Outcome:
    """axes: that passed the gate; left_out: components corrected in part or not; before, after: true rms by axis
    and of all, um.
    """

    axes: tuple[str, ...]
    left_out: int
    before: dict[str, float]
    after: dict[str, float]

    @property
    def worse(self) -> tuple[str, ...]:
        """Axes, corrected or not, or `all`, that are truly worse than without."""
        return tuple(n for n, size in self.before.items() if self.axes and self.after[n] > size + ROUNDING)


@one_thread()
def outcome(name: str, protocol: str, seed: int) -> Outcome:
    """One machine measured by one protocol. Raises DataError where the machine cannot be measured so."""
    machine = yamlfile.load(MACHINES / f"{name}.yaml", Machine)
    chain = compile_chain(machine)
    values = metrology.smooth_machine(chain, seed)
    tests = {protocol: _measured(chain, values, protocol, seed)}
    obs, _ = readings.of_tests(chain, tests)
    fitted = identify.identify(identify.Parametrisation.of(chain), obs)
    how = {"modes": 12, "without": [], "lasers": {}, "squares": {}}
    document = summary.document(fitted, obs, extra=False) | {"procedure": how}
    try:
        axes = gate.pass_gate(document, [gate.cross_validate(machine, document, tests)])
    except GateError:
        axes = ()
    factors = gate.compensated(document, chain)
    found = summary.errors(chain, document, factors)
    before, after = true_rms(chain, MachineErrors.of(chain, values, 401), found, axes)
    return Outcome(axes, len(chain.components) - sum(f == 1.0 for f in factors.values()), before, after)


def _measured(chain: Chain, values: metrology.Values, protocol: str, seed: int) -> Recording:
    if protocol == "direct":
        return direct_records.record(chain, values, direct_records.SetUp(noise=NOISE), seed)
    return metrology.simulate_runs(
        chain, values, protocol, measuring_runs.PROTOCOLS[protocol](chain), seed, noise=NOISE
    )


def true_rms(
    chain: Chain, truth: MachineErrors, found: MachineErrors, axes: tuple[str, ...]
) -> tuple[dict[str, float], dict[str, float]]:
    """rms over the travel of what each linear axis corrects, and of all of it, um; before and after.

    axes: those that are corrected. The workpiece's shift and turn is taken out, as its datum does.
    """
    linear = chain.machine.correcting_axes()

    def true(q: np.ndarray) -> np.ndarray:
        return synthesis.exact(chain, q, truth.at(q))[:, :3]

    def left(q: np.ndarray) -> np.ndarray:
        ways = synthesis.linear_motion(chain, q)
        moved = np.linalg.pinv(ways) @ synthesis.first_order(chain, q, found.at(q))[:, :3, None]
        moved *= np.array([a in axes for a in linear], dtype=float)[:, None]
        return true(q) - (ways @ moved)[:, :, 0]

    q = residual_error.mirrored_places(chain, PLACES, SEED)
    inverse = np.linalg.pinv(synthesis.linear_motion(chain, q))
    out = []
    for field in (true, left):
        size = (inverse @ residual_error.without_pose(chain, field, q)(q)[:, :, None])[:, :, 0]
        rms = dict(zip(linear, np.sqrt(np.mean(size**2, axis=0)).tolist(), strict=True))
        out.append(rms | {"all": float(np.sqrt(np.mean(np.sum(size**2, axis=1))))})
    return out[0], out[1]


def campaign(machines: list[str], protocols: list[str], seeds: range) -> Iterator[tuple[str, str, list[Outcome]]]:
    """Machine, protocol and its outcomes; without protocols that a machine cannot be measured by."""
    for name in machines:
        for protocol in protocols:
            try:
                yield name, protocol, [outcome(name, protocol, seed) for seed in seeds]
            except DataError:
                continue


def main() -> int:
    """Play all, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--machines", default=",".join(sorted(p.stem for p in MACHINES.glob("*.yaml"))))
    parser.add_argument("--protocols", default=",".join(PROTOCOLS))
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + asked.seeds)
    print("| machine | protocol | exported | in part | refused | worse | before -> after, um, median of exported |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    bad = 0
    for name, protocol, match in campaign(asked.machines.split(","), asked.protocols.split(","), seeds):
        whole = [o for o in match if o.axes]
        worse = [(seed, o.worse) for seed, o in zip(seeds, match, strict=True) if o.worse]
        bad += len(worse)
        residuals = "-"
        if whole:
            residuals = " -> ".join(
                f"{np.median([getattr(o, k)['all'] for o in whole]):.3g}" for k in ("before", "after")
            )
        part = sum(o.left_out > 0 for o in whole)
        row = (name, protocol, len(whole), part, len(match) - len(whole), worse or 0, residuals)
        print("| " + " | ".join(map(str, row)) + " |", flush=True)
    print(f"worse than nothing: {bad}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
