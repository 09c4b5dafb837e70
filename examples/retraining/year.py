"""A simulated year of nightly retraining: does it promote when it should, never a worse model, and name what drifts?

    python examples/retraining/year.py OUT [--seed 1] [--every 1]        # the year, through `errpipe retrain`
    python examples/retraining/year.py OUT --quiet [--seed 1]            # one in which nothing changes, likewise
    python examples/retraining/year.py --quiet-years 200 [--seed 1]      # many of these, by a refit without the command
    python examples/retraining/year.py --naming 20 [--drift 0.25]        # nights until the drifting sensor is named

The machine is simulated here and shares no code with the models: a screw that expands, a room with seasons, a nut
that warms with use. In May its bearing is changed, July is hot, in August the nut's sensor begins to drift, and one
night in October two sensors are swapped. The shop keeps the recordings of the last sixty nights.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe import jsonfile
from errpipe.cli.app import main as errpipe
from errpipe.fitting.validity import MARGIN
from errpipe.validation.retraining import ALPHA, RunScore, decide, e_value

KEPT = 60  # nights of recordings that the shop keeps
FIRST = 30  # nights that fit the first champion
BEARING, DRIFT, SWAP = 135, 215, 290  # nights: 15 May, 3 August, 17 October
DRIFT_PER_NIGHT = 0.5  # K; half of that takes more than three nights on one machine in three (docs/trials.md)
NOISE = 0.8  # um
STATE = "year.json"  # how far a year has come
PLACES = np.r_[np.arange(0.0, 601.0, 60.0), np.arange(600.0, -1.0, -60.0)]
MANIFEST = """recording: 1
title: X axis, one run a night
tables: [recording.csv]
constants:
  X: {role: axis, kind: linear, travel: [0, 600], screw_lead: 10, unit: mm}
columns:
  run: {role: run}
  t: {role: time, unit: s}
  x: {role: position, axis: X, unit: mm}
  dir: {role: direction, axis: X}
  T_nut: {role: temperature, unit: degC, location: nut}
  T_bed: {role: temperature, unit: degC, location: bed}
  T_air: {role: temperature, unit: degC, location: air}
  EXX: {role: error, component: EXX, unit: um}
"""
PIPELINE = """pipeline: 1
title: X axis, retrained every night
stages:
  - {kind: ingest, recording: recording}
  - kind: fit
    components:
      - component: EXX
        terms:
          - {term: offset}
          - {term: chebyshev, axis: X, degree: 2}
          - {term: scale_expansion, axis: X, sensor: T_nut}
    holdout: {scheme: batches, blocks: 4}
  - {kind: validate}
"""


def night(
    number: int, rng: np.random.Generator, quiet: bool = False, drift: float = DRIFT_PER_NIGHT
) -> dict[str, np.ndarray]:
    """One night: true deviation and readings at every place. Temperatures in degC, deviation in um, drift in K."""
    air = 20 + 5 * np.sin(2 * np.pi * (number - 105) / 365) + rng.normal(0, 0.7)
    air += 4.0 * (181 <= number < 212) * (not quiet)  # a hot July
    nut = air + rng.uniform(1.0, 6.0)
    bed = air + 0.3 * (nut - air) + rng.normal(0, 0.1)
    alpha, offset = (11.0, 0.0) if quiet or number < BEARING else (15.0, 6.0)
    true = offset + 10.0 * PLACES / 600 + alpha * 1e-3 * PLACES * (nut - 20)
    shown = {"T_nut": nut, "T_bed": bed, "T_air": air}
    if not quiet:
        shown["T_nut"] += drift * max(0, number - DRIFT)
        if number == SWAP:
            shown["T_nut"], shown["T_air"] = shown["T_air"], shown["T_nut"]
    readings = {name: np.round(value + rng.normal(0, 0.05, PLACES.size), 2) for name, value in shown.items()}
    return {"x": PLACES, "true": true, "EXX": true + rng.normal(0, NOISE, PLACES.size), **readings}


def write(folder: Path, nights: dict[int, dict[str, np.ndarray]]) -> None:
    """The recording of some nights."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for number, values in nights.items():
        side = np.where(np.arange(PLACES.size) <= PLACES.size // 2 - 1, 1, -1)
        time = 86400.0 * number + 5.0 * np.arange(PLACES.size)
        columns = {k: np.round(v, 3) for k, v in values.items() if k != "true"}
        parts.append(pd.DataFrame({"run": f"night {number}", "t": time, "dir": side, **columns}))
    pd.concat(parts, ignore_index=True).to_csv(folder / "recording.csv", index=False)
    (folder / "recording.yaml").write_text(MANIFEST, encoding="utf-8")


def residual(model: Path, nights: list[dict[str, np.ndarray]]) -> float:
    """rms of what a model's table leaves of the true deviation of some nights, um: what the report cannot know."""
    from errpipe.domain.error_model import ErrorModel
    from errpipe.fitting.validity import as_in_a_table
    from errpipe.formats import manifest_folder
    from errpipe.validation.predict import predict

    document = ErrorModel.model_validate_json(model.read_text(encoding="utf-8"))
    folder = model.parent / "judge"
    write(folder, dict(enumerate(nights)))
    recording, left = as_in_a_table(manifest_folder.read(folder), document.validity)
    predicted = left * predict(document, recording)["EXX_predicted"].to_numpy()
    shutil.rmtree(folder)
    return float(np.sqrt(np.mean((np.concatenate([n["true"] for n in nights]) - predicted) ** 2)))


def year(
    out: Path, seed: int, every: int, until: int = 365, drift: float = DRIFT_PER_NIGHT, quiet: bool = False
) -> dict[str, Any]:
    """The year, or a quiet one in which nothing changes: every `every` nights the shop retrains.

    What happened, and what it was truly worth. It goes on from the night after the last one where OUT holds the begin
    of this year.
    """
    rng = np.random.default_rng(seed)
    nights = [night(k, rng, quiet, drift) for k in range(365)]
    state = _begun(out, {"seed": seed, "every": every, "drift": drift, "quiet": quiet}, nights)
    for today in range(state["next"], until, every):
        kept = range(max(0, today - KEPT), today)
        write(out / "recording", {k: nights[k] for k in kept})
        folders = ["--champion", str(out / "champion"), "--out", str(out / "retrain")]
        code = errpipe(["retrain", str(out / "axis.yaml"), *folders])
        document = json.loads((out / "retrain/retrain.json").read_text(encoding="utf-8"))
        for alarm in document["drift"]["inputs"]:
            if alarm["isolated"]:
                state["sensors_named"].setdefault(alarm["column"], today)
            state["alarms"].setdefault(alarm["column"], today)
        if code == 0:
            sound = [n for k, n in enumerate(nights) if today <= k < today + 14 and (quiet or k != SWAP)]
            models = (out / name / "fit/error_model.json" for name in ("champion", "retrain/run"))
            before, after = (residual(model, sound) for model in models)
            state["worse_promotions"] += after > 1.02 * before  # two per cent is within what two weeks can tell
            state["promotions"].append({"night": today, "um_rms_before": before, "um_rms_after": after})
            shutil.rmtree(out / "champion")
            shutil.copytree(out / "retrain/run", out / "champion")
        tonight = residual(out / "champion/fit/error_model.json", nights[today : today + 1])
        state["um_rms_in_use"].append(round(tonight, 3))
        state["next"] = today + every
        jsonfile.write(out / STATE, state)
    return state


def _begun(out: Path, asked: dict[str, Any], nights: list[dict[str, np.ndarray]]) -> dict[str, Any]:
    """The year as far as it has come: a champion fitted on the first nights where nothing is there yet."""
    if (out / STATE).is_file():
        state = jsonfile.read(out / STATE)
        if {key: state.get(key) for key in asked} == asked:
            return state
    _first_champion(out, dict(enumerate(nights[:FIRST])))
    by_name: dict[str, Any] = {"promotions": [], "worse_promotions": 0, "sensors_named": {}, "alarms": {}}
    by_name["um_rms_in_use"] = []  # of the table that was on the machine, by night
    return by_name | asked | {"next": FIRST + asked["every"]}


def _first_champion(out: Path, nights: dict[int, dict[str, np.ndarray]]) -> None:
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    (out / "axis.yaml").write_text(PIPELINE, encoding="utf-8")
    write(out / "recording", nights)
    assert errpipe(["run", str(out / "axis.yaml"), "--out", str(out / "champion")]) == 0


def nights_until_named(out: Path, seed: int, drift: float, most: int = 14) -> int | None:
    """Nights of drift after which `errpipe retrain` blames the sensor that drifts; None beyond `most`."""
    rng = np.random.default_rng(seed)
    nights = {k: night(k, rng, drift=drift) for k in range(DRIFT + most + 1)}
    _first_champion(out, {k: nights[k] for k in range(DRIFT - KEPT, DRIFT + 1)})
    for count in range(1, most + 1):
        write(out / "recording", {k: nights[k] for k in range(DRIFT + count - KEPT, DRIFT + count + 1)})
        errpipe(["retrain", str(out / "axis.yaml"), "--champion", str(out / "champion"), "--out", str(out / "retrain")])
        document = json.loads((out / "retrain/retrain.json").read_text(encoding="utf-8"))
        if any(d["isolated"] and d["column"] == "T_nut" for d in document["drift"]["inputs"]):
            return count
    return None


def quiet_year(seed: int) -> bool:
    """A year in which nothing changes, with the same decision and a plain refit: was a worse table ever promoted?"""
    rng = np.random.default_rng(seed)
    nights = [night(k, rng, quiet=True) for k in range(365)]

    def design(some: list[dict[str, np.ndarray]]) -> np.ndarray:
        x, t = (np.concatenate([n[name] for n in some]) for name in ("x", "T_nut"))
        return np.column_stack([np.ones_like(x), x, x**2, x * (t - 20.0)])

    Table = tuple[np.ndarray, float, float]  # gains, lowest and highest temperature of the nut

    def fit(some: list[dict[str, np.ndarray]], lowest: float = np.inf, highest: float = -np.inf) -> Table:
        nut = np.concatenate([n["T_nut"] for n in some])
        gains = np.linalg.lstsq(design(some), np.concatenate([n["EXX"] for n in some]), rcond=None)[0]
        return gains, min(nut.min(), lowest), max(nut.max(), highest)

    def left(table: Table, one: dict[str, np.ndarray], name: str) -> float:
        gains, lowest, highest = table
        held = np.clip(one["T_nut"], lowest, highest)
        share = np.maximum(1.0 - np.abs(one["T_nut"] - held) / max(MARGIN * (highest - lowest), 2.0), 0.0)
        return float(np.mean((one[name] - share * (design([one | {"T_nut": held}]) @ gains)) ** 2))

    champion, scores = fit(nights[:FIRST]), []
    for today in range(FIRST, 365):
        challenger, one = fit(nights[max(0, today - KEPT) : today], *champion[1:]), nights[today]
        squares = (float(np.mean(one["EXX"] ** 2)), left(champion, one, "EXX"), left(challenger, one, "EXX"))
        scores.append(RunScore(str(today), str(today), "EXX", {}, *squares, rows=PLACES.size))
        if e_value([s.score for s in scores]) >= 1 / ALPHA and decide(scores).promote:
            rest = nights[today + 1 :] or [one]
            if np.mean([left(challenger, n, "true") - left(champion, n, "true") for n in rest]) > 0:
                return True
            champion, scores = challenger, []
    return False


def main() -> None:
    parser = argparse.ArgumentParser(description="A simulated year of nightly retraining.")
    parser.add_argument("out", nargs="?", type=Path, default=Path("out/retraining"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", type=int, default=1, help="nights between retrainings")
    parser.add_argument("--until", type=int, default=365, help="stop before this night; the same command goes on")
    parser.add_argument("--quiet", action="store_true", help="a year in which nothing changes")
    parser.add_argument("--quiet-years", type=int, default=0, help="as many, by the decision on a plain refit alone")
    parser.add_argument("--naming", type=int, default=0, help="machines of which the drifting sensor is to be named")
    parser.add_argument("--drift", type=float, default=DRIFT_PER_NIGHT, help="K a night")
    a = parser.parse_args()
    if a.naming:
        matches = [nights_until_named(a.out / "naming", 1000 * a.seed + k, a.drift) for k in range(a.naming)]
        soon = sum(count is not None and count <= 3 for count in matches)
        print(f"{a.drift:g} K a night: named within three nights in {soon} of {a.naming} machines; nights: {matches}")
        return
    if a.quiet_years:
        harmed = sum(quiet_year(1000 * a.seed + k) for k in range(a.quiet_years))
        print(f"{harmed} of {a.quiet_years} quiet years saw a promotion that made the machine worse")
        return
    print(json.dumps(year(a.out, a.seed, a.every, a.until, a.drift, a.quiet), indent=1))


if __name__ == "__main__":
    main()
