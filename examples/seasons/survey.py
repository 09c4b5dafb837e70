"""Does a thermal model survive the season? Every figure of the seasonal question, on a recording of yours.

    python examples/seasons/survey.py RECORDING_FOLDER --component E_D --out out/seasons [table cycles
        forward daily hotter readings hours failures]

Writes one JSON and one SVG per question into the output folder and prints the table. All of it takes minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from learning_curve import curve

from errpipe import jsonfile
from errpipe.domain.recording import Recording
from errpipe.fitting import holdout, recalibration
from errpipe.fitting.statistics import rms
from errpipe.formats import manifest_folder
from errpipe.reporting import run_figures, svg
from errpipe.thermal import arithmetic
from errpipe.thermal import season as thermal_season
from errpipe.validation import seasons

SEASON = "leave-one-group-out:season"


def season(correction: bool = True) -> seasons.Fitter:
    """Fits the season model, with or without its correction."""
    options = thermal_season.SeasonOptions(correction=correction)
    return lambda recording, component, rows: thermal_season.fit(recording, component, options, rows)


def bars(groups: list[str], series: dict[str, list[float]], label: str, title: str) -> str:
    """Grouped bars as SVG text."""
    with svg.figure() as (canvas, axes):
        width = 0.8 / len(series)
        shades = (svg.BEFORE, svg.AFTER, svg.FLOOR, svg.ALARM)
        for k, (name, values) in enumerate(series.items()):
            axes.bar(np.arange(len(groups)) + k * width, values, width, label=name, color=shades[k % 4])
        axes.set_xticks(np.arange(len(groups)) + 0.4 - width / 2, groups)
        axes.set_ylabel(label)
        axes.legend()
        return svg.to_svg(canvas, title)


def lines(series: dict[str, tuple[list[float], list[float]]], across: str, up: str, title: str) -> str:
    """Lines with dots as SVG text."""
    with svg.figure() as (canvas, axes):
        for (name, (x, y)), mark in zip(series.items(), "os^vDx" * 4, strict=False):
            axes.plot(x, y, marker=mark, label=name)
        axes.set_xlabel(across)
        axes.set_ylabel(up)
        axes.set_ylim(bottom=0)
        axes.legend()
        return svg.to_svg(canvas, title)


def text(document: dict[str, Any]) -> str:
    """The table for a terminal."""
    names = ("left_out", *seasons.FIGURES)
    lines = ["  ".join(f"{n:>13}" for n in names)]
    for row in document["groups"]:
        cells = [row["left_out"], *(row[n] for n in names[1:])]
        lines.append("  ".join(f"{_cell(c):>13}" for c in cells))
    for month in document.get("months", ()):
        figures = f"{month['uncompensated']:.2f} -> {month['out_of_season']:.2f} um over {month['days']} days"
        lines.append(f"{month['month']}  {figures}")
    gap = document["optimism"]
    if gap:
        promised, kept = gap["random_rows"], gap["groups_left_out"]
        lines.append(f"random rows promise {promised:.2f} um; groups left out keep {kept:.2f} um")
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "-" if value is None else f"{value:.2f}"


def table(recording: Recording, component: str, scheme: str = SEASON, runs: bool = True) -> tuple[Any, str]:
    """Item: left-out group x uncompensated, in season, out of season, ratio, bias, scatter, worst row, coverage."""
    told = seasons.table(recording, component, season(), scheme, in_season=runs)
    print(text(told))
    rows = told["groups"]
    series = {"uncompensated": [r["uncompensated"] for r in rows]}
    if runs:
        series["own season known"] = [r["in_season"] for r in rows]
    series["left out whole"] = [r["out_of_season"] for r in rows]
    return told, bars([r["left_out"] for r in rows], series, "rms in um", f"Residual by {scheme}")


def forward(recording: Recording, component: str) -> tuple[Any, str]:
    """Trained on the past only, month by month."""
    return table(recording, component, "forward:month", runs=False)


def daily(recording: Recording, component: str) -> tuple[Any, str]:
    """Trained anew every day on the past only, days pooled by months."""
    told, _ = table(recording, component, "forward:day", runs=False)
    months = told["months"]
    series = {n: [m[k] for m in months] for n, k in (("uncompensated",) * 2, ("trained on the past", "out_of_season"))}
    return told, bars([m["month"] for m in months], series, "rms in um", "Residual, trained anew every day")


def cycles(recording: Recording, component: str) -> tuple[Any, str]:
    """Each duty cycle left out whole."""
    return table(recording, component, "leave-one-group-out:duty_cycle", runs=False)


def hotter(recording: Recording, component: str) -> tuple[Any, str]:
    """A summer that never was: every day again with all temperatures shifted, as if the deviation stayed the same."""
    model = thermal_season.fit(recording, component)
    y, run = arithmetic.since_start_of(recording, component), recording.run_codes()
    told = []
    for shift in (-8.0, -4.0, 0.0, 2.0, 4.0, 6.0, 10.0, 15.0):
        moved = {n: recording.array(n) + shift for n in recording.names("temperature")}
        value = model.predict(Recording(recording.manifest, recording.frame.assign(**moved)))
        left = y - value.predicted
        worse = [rms(left[run == c]) > rms(y[run == c]) for c in np.unique(run)]
        told.append(
            {
                "shift_K": shift,
                "rms": rms(left),
                "uncompensated": rms(y),
                "runs_worse_than_nothing": int(sum(worse)),
                "largest": float(np.abs(value.predicted).max()),
                "half_width": float(np.mean(value.upper - value.lower)) / 2,
            }
        )
        print({k: round(v, 1) for k, v in told[-1].items()})
    shifts = [e["shift_K"] for e in told]
    series = {
        word: (shifts, [e[key] for e in told])
        for word, key in (("residual", "rms"), ("uncompensated", "uncompensated"), ("half width", "half_width"))
    }
    return told, lines(series, "all temperatures shifted by, K", "um", "The same days in another climate")


def readings(recording: Recording, component: str) -> tuple[Any, str]:
    """Residual against the number of probe readings in eight hours, the season left out whole."""
    y, folds = arithmetic.since_start_of(recording, component), holdout.groups(recording, SEASON)
    left = [y - thermal_season.fit(recording, component, rows=f.train).values(recording) for f in folds]
    rows = [np.flatnonzero(f.test & np.isfinite(y)) for f in folds]
    told = recalibration.by_readings(
        recording, rows, [f.label for f in folds], [y[r] for r in rows], [v[r] for v, r in zip(left, rows, strict=True)]
    )
    for level in told["levels"]:
        print(level)
    return told, run_figures.by_readings(told["levels"], component, "um")


def hours(recording: Recording, component: str) -> tuple[Any, str]:
    """Residual of a season left out against hours of data."""
    told = curve(recording, component, season(correction=False), SEASON, orders=4)
    series = {}
    for group in dict.fromkeys(e["left_out"] for e in told):
        mine = [e for e in told if e["left_out"] == group]
        sizes = sorted({e["runs"] for e in mine})
        middle = [float(np.median([e["rms"] for e in mine if e["runs"] == s])) for s in sizes]
        spent = [float(np.median([e["hours"] for e in mine if e["runs"] == s])) for s in sizes]
        series[f"{group} left out (median of 5 orders)"] = (spent, middle)
        print(group, [(f"{n} runs", f"{h:.0f} h", round(r, 1)) for n, h, r in zip(sizes, spent, middle, strict=True)])
    return told, lines(series, "hours of measuring", "rms in um", "Residual against hours of characterisation")


def failures(recording: Recording, component: str) -> tuple[Any, str]:
    """Each sensor failed in five ways two hours into every run of a season left out: healthy, failed, recovered."""
    told = []
    y = arithmetic.since_start_of(recording, component)
    run, t = recording.run_codes(), recording.time()
    for fold in holdout.groups(recording, SEASON):
        model = thermal_season.fit(recording, component, rows=fold.train)
        healthy = rms((y - model.values(recording))[fold.test])
        for name in recording.names("temperature"):
            relation = _relation(recording, name, fold.train)
            for way, spoil in WAYS.items():
                reading = recording.array(name).copy()
                for code in np.unique(run[fold.test]):
                    rows = np.flatnonzero(run == code)
                    after = rows[t[rows] - t[rows[0]] > 7200.0]
                    reading[after] = spoil(reading[after], reading[after[0]], (t[after] - t[after[0]]) / 3600.0)
                broken = Recording(recording.manifest, recording.frame.assign(**{name: reading}))
                mended, seen_after = _recover(broken, name, relation)
                told.append(
                    {
                        "left_out": fold.label,
                        "sensor": name,
                        "failure": way,
                        "healthy": healthy,
                        "failed": rms((y - model.values(broken))[fold.test]),
                        "recovered": rms((y - model.values(mended))[fold.test]),
                        "rows_to_detection": seen_after,
                    }
                )
    worst = max(told, key=lambda e: e["recovered"] / e["healthy"])
    for e in told:
        print({k: round(v, 2) if isinstance(v, float) else v for k, v in e.items()})
    print("worst ratio recovered / healthy:", round(worst["recovered"] / worst["healthy"], 2))
    names = list(recording.names("temperature"))
    series = {
        word: [float(np.sqrt(np.mean([e[word] ** 2 for e in told if e["sensor"] == n]))) for n in names]
        for word in ("failed", "recovered", "healthy")
    }
    return told, bars(names, series, "rms in um, season left out", "Sensors failed in turn")


WAYS: dict[str, Callable[[np.ndarray, float, np.ndarray], np.ndarray]] = {
    "dead": lambda x, first, hours: np.zeros_like(x),
    "stuck": lambda x, first, hours: np.full_like(x, first),
    "drifting": lambda x, first, hours: x + 1.5 * hours,
    "stepped": lambda x, first, hours: x + 4.0,
    "noisy": lambda x, first, hours: x + 3.0 * np.sign(np.sin(40.0 * hours)),
}


def _relation(recording: Recording, name: str, rows: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, float]:
    """The sensor from the others by least squares on readings since the start of the run; and its tolerance, K."""
    others = tuple(n for n in recording.names("temperature") if n != name)
    run = recording.run_codes()
    rise = {n: thermal_season.since_start(recording.array(n), run, 1)[0] for n in (name, *others)}
    x = np.column_stack([rise[n] for n in others])
    weights = np.linalg.lstsq(x[rows], rise[name][rows], rcond=None)[0]
    left = np.abs(rise[name] - x @ weights)[rows]
    return others, weights, 1.5 * float(left.max())


def _recover(recording: Recording, name: str, relation) -> tuple[Recording, float | None]:
    """Readings replaced by their estimate from the first one out of tolerance on; mean rows until then. Causal."""
    others, weights, tolerance = relation
    run = recording.run_codes()
    start = {n: recording.array(n) - thermal_season.since_start(recording.array(n), run, 1)[0] for n in (name, *others)}
    estimate = start[name] + np.column_stack([recording.array(n) - start[n] for n in others]) @ weights
    reading, waits = recording.array(name).copy(), []
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        bad = np.flatnonzero(np.abs(reading[rows] - estimate[rows]) > tolerance)
        if bad.size:
            reading[rows[bad[0] :]] = estimate[rows[bad[0] :]]
            failed = np.searchsorted(recording.time()[rows] - recording.time()[rows[0]], 7200.0)
            waits.append(max(0, int(bad[0] - failed)))
    mended = Recording(recording.manifest, recording.frame.assign(**{name: reading}))
    return mended, float(np.mean(waits)) if waits else None


ASKED = (table, cycles, forward, daily, hotter, readings, hours, failures)
QUESTIONS = {f.__name__: f for f in ASKED}


def main() -> None:
    """Answer the questions asked for, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("questions", nargs="*", choices=[*QUESTIONS, []], default=[])
    parser.add_argument("--component", default="E_D")
    parser.add_argument("--out", type=Path, default=Path("out/seasons"))
    told = parser.parse_args()
    recording = manifest_folder.read(told.folder)
    told.out.mkdir(parents=True, exist_ok=True)
    for name in told.questions or QUESTIONS:
        print(f"-- {name}")
        document, picture = QUESTIONS[name](recording, told.component)
        jsonfile.write(told.out / f"{name}.json", {"survey": 1, "question": name, "answer": document})
        jsonfile.write_text(told.out / f"{name}.svg", picture)


if __name__ == "__main__":
    main()
