"""All benches one after the other, each in its own process: `make bench`, or `python -m bench [NAME...]`.

Writes docs/performance.md, docs/performance.json and docs/pictures/growth.png (a run of some benches keeps the figures
of the others), and says what got slower than in the last JSON by more than the spread of both runs, twice. The exit
code is 1 where a bench broke; an aim that is missed is marked in the table.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

from bench.figure import Figure

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
PEERS = ("dask", "numpy", "scipy", "numba", "scikit-learn", "pandas", "pyarrow", "pydantic")
NOISE = 0.05  # relative; on a shared machine the same run differs by as much


def measure(name: str) -> dict[str, Any] | None:
    """Figures and peak memory (MB) of one bench in a process of its own; None where it broke."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "figures.json"
        child = subprocess.Popen([sys.executable, "-m", f"bench.bench_{name}", "--json", str(out)])
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode != 0 or not out.is_file():
            return None
        return {"peak_mb": round(used.ru_maxrss / 1024), "figures": json.loads(out.read_text("utf-8"))}


def slower(old: dict[str, Any], new: dict[str, Any]) -> dict[tuple[str, str], str]:
    """(bench, figure) -> what costs more than in the last run, by more than the spread of both.

    What was timed beside a peer is compared as a ratio to it: a busier machine slows down both.
    """
    before = {(n, f["what"]): Figure(**f) for n, part in old.items() for f in part["figures"]}
    out = {}
    for name, part in new.items():
        for figure in (Figure(**f) for f in part["figures"]):
            last = before.get((name, figure.what))
            if last is None or not last.value or not figure.value:
                continue
            change = figure.value / last.value
            if figure.times and last.times and figure.peer == last.peer:
                change = last.times / figure.times
            if (1.0 / change if figure.at_least else change) - 1.0 > NOISE + figure.spread + last.spread:
                line = f"{name}: {figure.what}: {last.value:.4g} -> {figure.value:.4g} {figure.unit}"
                out[name, figure.what] = line + (f" ({change:.3g} times beside the peer)" if figure.times else "")
    return out


def confirmed(last: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """What is slower in a second look, too: each bench with something slower is run once more."""
    suspected = slower(last, new)
    again = {}
    for name in dict.fromkeys(name for name, _ in suspected):
        print(f"== {name}, once more: something looks slower than in the last run", flush=True)
        again[name] = measure(name) or new[name]
    return list(filter(None, (suspected.get(key) for key in slower(last, again))))


def page(benches: dict[str, Any], facts: dict[str, str]) -> str:
    """docs/performance.md."""
    about = "For those who plan hardware: run time and memory, as ratios to a reference. Written by `make bench`; "
    lines = ["# Performance", "", about + "the two are run alternately in one process.", ""]
    lines += [f"* {name}: {text}" for name, text in facts.items()]
    for name, part in benches.items():
        lines += ["", f"## {name}", "", f"Peak memory of the bench: {part['peak_mb']} MB", ""]
        lines += ["![Cost over size](pictures/growth.png)", ""] if name == "growth" else []
        lines += [
            "| what | value | aim | beside it | times the cost | what that does not do |",
            "|---|---|---|---|---|---|",
        ]
        for figure in (Figure(**f) for f in part["figures"]):
            aim = "" if figure.aim is None else f"{'≥' if figure.at_least else '≤'} {figure.aim:g}"
            times = "" if figure.times is None else f"{figure.times:.3g}"
            marked = f"**{aim} missed**" if figure.missed else aim
            cells = (figure.what, f"{figure.value:.4g} {figure.unit}", marked, figure.peer, times, figure.lacks)
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw_growth(figures: list[Figure], file: Path) -> None:
    """Cost over size on logarithmic axes, one panel for costs in ns and one for those in s."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    curves: dict[str, dict[str, list[tuple[int, float]]]] = {}
    for figure in figures:
        what, _, size = figure.what.rpartition(": ")
        if size.isdigit():
            curves.setdefault(figure.unit, {}).setdefault(what, []).append((int(size), figure.value))
    whole, panels = plt.subplots(1, len(curves), figsize=(5 * len(curves), 4), layout="constrained", squeeze=False)
    for panel, (unit, by_what) in zip(panels[0], curves.items(), strict=True):
        for what, points in by_what.items():
            panel.loglog(*zip(*points, strict=True), "o-", label=what)
        panel.set(xlabel="size", ylabel=f"cost, {unit}")
        panel.legend(fontsize="small", frameon=False)
    whole.savefig(file, dpi=80, metadata={"Software": None})


def machine() -> dict[str, str]:
    """Processor, cores, Python and the versions of what is run beside errpipe."""
    lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines() if Path("/proc/cpuinfo").is_file() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in PEERS)
    return {"machine": f"{model}, {os.cpu_count()} cores", "python": platform.python_version(), "versions": versions}


def main(names: list[str]) -> int:
    """Run the benches named (all without names); 1 where one of them broke."""
    store = DOCS / "performance.json"
    last = json.loads(store.read_text("utf-8"))["benches"] if store.is_file() else {}
    new, broken = {}, []
    for name in names or sorted(path.stem.removeprefix("bench_") for path in HERE.glob("bench_*.py")):
        print(f"== {name}", flush=True)
        measured = measure(name)
        if measured is None:
            broken.append(name)
        else:
            new[name] = measured
    facts = machine()
    benches = dict(sorted({**last, **new}.items()))
    text = json.dumps({"performance": 1, "machine": facts, "benches": benches}, indent=1, sort_keys=True)
    store.write_text(text + "\n", "utf-8")
    (DOCS / "performance.md").write_text(page(benches, facts), "utf-8")
    if "growth" in new:
        draw_growth([Figure(**f) for f in new["growth"]["figures"]], DOCS / "pictures" / "growth.png")
    for line in confirmed(last, new):
        print(f"slower: {line}")
    for name in broken:
        print(f"broke: {name}")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
