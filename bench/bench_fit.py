"""Streaming fit against numpy's lstsq in memory: python -m bench.bench_fit. Times and peak memory of one run.

Each side runs in a process of its own, so that its peak memory is its own; the rows are made chunk by chunk from the
same seeds, which costs both the same.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time

import numpy as np

ROWS, COLUMNS, CHUNK = 2_000_000, 12, 50_000


def chunks():
    """The same rows for both sides: position powers, temperatures, products, noise."""
    truth = np.arange(1.0, COLUMNS + 1)
    for k in range(ROWS // CHUNK):
        rng = np.random.default_rng(k)
        design = rng.normal(size=(CHUNK, COLUMNS))
        yield design, design @ truth + rng.normal(size=CHUNK)


def streaming() -> tuple[float, np.ndarray]:
    """(seconds spent fitting, coefficients), rows never together in memory."""
    from errpipe.fitting.streaming import StreamingFit

    running, spent = StreamingFit(COLUMNS), 0.0
    for design, response in chunks():
        begin = time.perf_counter()
        running.add(design, response)
        spent += time.perf_counter() - begin
    begin = time.perf_counter()
    coefficients = running.solve()[0]
    return spent + time.perf_counter() - begin, coefficients


def in_memory() -> tuple[float, np.ndarray]:
    """(seconds spent fitting, coefficients), all rows together."""
    parts = list(chunks())
    design, response = np.vstack([d for d, _ in parts]), np.concatenate([y for _, y in parts])
    del parts
    begin = time.perf_counter()
    coefficients = np.linalg.lstsq(design, response, rcond=None)[0]
    return time.perf_counter() - begin, coefficients


def alone(side: str) -> dict:
    """One side in a fresh process: seconds, peak memory in MB above that of the imports, coefficients."""
    done = subprocess.run([sys.executable, "-m", "bench.bench_fit", side], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def child(side: str) -> None:
    """What the fresh process does."""
    import errpipe.fitting.streaming  # noqa: F401  (counted as imports on both sides)

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seconds, coefficients = streaming() if side == "streaming" else in_memory()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"s": seconds, "MB": (peak - before) / 1024, "coefficients": coefficients.tolist()}))


def report() -> list[str]:
    """Lines of the report, ratios first."""
    ours, theirs = alone("streaming"), alone("lstsq")
    apart = float(np.abs(np.subtract(ours["coefficients"], theirs["coefficients"])).max())
    return [
        f"fit, {ROWS / 1e6:g} M rows x {COLUMNS}: streaming takes {ours['s'] / theirs['s']:.2f} of numpy lstsq's time "
        f"({ours['s']:.2f} s against {theirs['s']:.2f} s)",
        f"  and {ours['MB'] / theirs['MB']:.3f} of its memory ({ours['MB']:.0f} MB against {theirs['MB']:.0f} MB); "
        f"coefficients differ by {apart:.1e} at most",
    ]


if __name__ == "__main__":
    if len(sys.argv) > 1:
        child(sys.argv[1])
    else:
        print("\n".join(report()))
