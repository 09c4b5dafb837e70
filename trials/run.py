"""Draw cases, diagnose them with errpipe, judge the answers.

python -m trials.run --seed 7 --cases 130 --jobs 2 [--second | --third] [--keep DIR] [--json FILE] [--markdown FILE]
"""

from __future__ import annotations

import argparse
import hashlib
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter

from trials.command import add_reports, print_failures, write_reports

from .first.generate import generate, split
from .score import document, figures, markdown, score, wrong_ones
from .third.generate import generate as generate_third


def diagnose(case: str, out: str) -> tuple[str, float, str]:
    """One case in a worker process: seconds and what went wrong ('' for nothing)."""
    from errpipe.stages.diagnose import diagnose as work

    start = perf_counter()
    try:
        work(Path(case), Path(out))
    except Exception as err:  # a crash is an answer too: none
        return Path(case).name, perf_counter() - start, f"{type(err).__name__}: {err}"
    return Path(case).name, perf_counter() - start, ""


def diagnose_all(cases: Path, out: Path, jobs: int) -> list[tuple[str, float, str]]:
    """Diagnose every case of a folder into out/<id>/diagnosis.json."""
    folders = sorted(p for p in cases.iterdir() if p.is_dir())
    done = []
    with ProcessPoolExecutor(jobs) as pool:
        work = [pool.submit(diagnose, str(f), str(out / f.name)) for f in folders]
        for i, w in enumerate(work):
            done.append(w.result())
            if (i + 1) % 10 == 0:
                print(f"{i + 1} of {len(work)} diagnosed", flush=True)
    return done


def generate_second(out: Path, seed: int, count: int, tiers: str | None, effects: str | None, protocols: str | None):
    """Cases of the second generator, laid out and sealed as the first one's are."""
    from trials.second.generate import TIERS, cases
    from trials.second.write import write_case

    (out / "answers").mkdir(parents=True)
    wanted = (split(tiers) or list(TIERS), split(effects), split(protocols))
    digests = []
    for name, *case in cases(seed, count, *wanted):
        write_case(out / "cases" / name, name, *case)
        key = (out / "cases" / name / "answer.json").rename(out / "answers" / f"{name}.json")
        digests.append(f"{hashlib.sha256(key.read_bytes()).hexdigest()}  answers/{name}.json\n")
    (out / "answers.sha256").write_text("".join(sorted(digests, key=lambda line: line.split("  ")[1])))


def main() -> None:
    parser = argparse.ArgumentParser(description="Blind trials: draw, diagnose, judge.")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cases", type=int, default=130)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--tiers", help="comma-separated")
    parser.add_argument("--effects", help="comma-separated effect ids")
    parser.add_argument("--protocols", help="comma-separated")
    parser.add_argument("--second", action="store_true", help="cases of the second generator")
    parser.add_argument("--third", action="store_true", help="cases of the third generator (real noise, every scale)")
    add_reports(parser)
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out = a.keep or Path(temporary) / "trials"
        if a.second:
            generate_second(out, a.seed, a.cases, a.tiers, a.effects, a.protocols)
        elif a.third:
            generate_third(out, a.seed, a.cases, split(a.tiers), split(a.effects))
        else:
            generate(out, a.seed, a.cases, split(a.tiers), split(a.effects), split(a.protocols))
        done = diagnose_all(out / "cases", out / "diagnoses", a.jobs)
        judged = score(out, out / "diagnoses")
    by = " by the second generator" if a.second else " by the third generator" if a.third else ""
    text = markdown(judged, f"{len(judged)} cases drawn with seed {a.seed}{by}")
    print(text)
    print(wrong_ones(judged))
    print_failures(done)
    write_reports(a, text, document(judged))
    print(f"right {100 * (figures(judged)['correct'] or 0):.1f} %")


if __name__ == "__main__":
    main()
