"""`errpipe place` and `errpipe plan-day` from the command line, on files of which the answer is known."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main


def field(tmp_path, seed=1, noise=0.2):
    """Four places and an error of 3 x near - 1 x wall; two places hold other things."""
    rng = np.random.default_rng(seed)
    rows = []
    for duty in range(5):
        near, wall, far, room = (np.cumsum(rng.normal(0, 0.2, 80)) for _ in range(4))
        error = 3.0 * (near - near[0]) - (wall - wall[0]) + noise * rng.standard_normal(80)
        rows.append(
            pd.DataFrame({"duty_cycle": duty, "near": near, "wall": wall, "far": far, "room": room, "error": error})
        )
    path = tmp_path / "field.csv"
    pd.concat(rows).to_csv(path, index=False)
    return path


def asked(capsys, *words):
    code = main([*words, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_the_places_that_make_the_error_are_chosen(tmp_path, capsys):
    code, document = asked(capsys, "place", str(field(tmp_path)))
    assert code == 0
    assert set(document["result"]["chosen"]) == {"near", "wall"}
    two = document["result"]["by_number"][1]
    assert two["rms_left_out"] == pytest.approx(0.2 * np.sqrt(2), rel=0.3)  # noise, and the noise of its first row


def test_a_spindle_speed_is_no_place_and_the_way_to_fit_the_chosen_alone_is_told(tmp_path, capsys):
    file = field(tmp_path)
    frame = pd.read_csv(file)
    frame.assign(spindle_rpm=1000.0 * frame["error"]).to_csv(file, index=False)
    code, document = asked(capsys, "place", str(file))
    assert code == 0
    assert set(document["result"]["chosen"]) == {"near", "wall"}
    assert document["result"]["speeds"] == ["spindle_rpm"]
    assert main(["place", str(file)]) == 0
    told = capsys.readouterr().out
    assert "not a sensor position but a speed: spindle_rpm (its name)" in told
    assert "the role ignore, as far: {role: ignore}" in told
    frame[["duty_cycle", "error"]].assign(Speed=frame["far"]).to_csv(file, index=False)
    assert main(["place", str(file)]) == 3
    assert "no candidate sensor position except Speed, which is a speed" in capsys.readouterr().err


def test_the_maximum_number_is_not_called_enough(tmp_path, capsys):
    """Only one sensor was tried: that two are better was not said."""
    file = str(field(tmp_path))
    assert main(["place", file, "--most", "1"]) == 0
    assert "1 is the maximum that was tried: whether more are better is not known (--most 2)" in capsys.readouterr().out
    assert main(["place", file]) == 0
    assert "maximum" not in capsys.readouterr().out  # two of four are chosen


def test_where_nothing_tells_the_error_nothing_is_chosen(tmp_path, capsys):
    frame = pd.read_csv(field(tmp_path))
    frame["error"] = np.random.default_rng(5).standard_normal(len(frame))
    frame.to_csv(tmp_path / "noise.csv", index=False)
    _, document = asked(capsys, "place", str(tmp_path / "noise.csv"))
    assert document["result"]["chosen"] == []


def test_too_few_duty_cycles_are_called_that(tmp_path, capsys):
    """Two cycles of which one hardly moves: the sensors are right, but nothing shows it."""
    frame = pd.read_csv(field(tmp_path))
    frame = frame[frame["duty_cycle"] < 2]
    frame.loc[frame["duty_cycle"] == 1, ["near", "wall", "far", "room", "error"]] *= 0.01
    frame.to_csv(tmp_path / "few.csv", index=False)
    assert main(["place", str(tmp_path / "few.csv")]) == 0
    assert "choose none: 2 duty cycles are too few" in capsys.readouterr().out
    assert main(["place", str(tmp_path / "few.csv"), "--group", "shift"]) == 3
    assert "--group names the column of duty cycles" in capsys.readouterr().err


def test_the_duty_cycle_in_which_a_sensor_jumps_is_named(tmp_path, capsys):
    frame = pd.read_csv(field(tmp_path))
    frame = frame.drop(columns=["wall"])
    frame.loc[180:239, "near"] += 90.0  # in duty cycle 2
    frame.to_csv(tmp_path / "jump.csv", index=False)
    assert main(["place", str(tmp_path / "jump.csv")]) == 0
    said = capsys.readouterr().out
    assert "no sensor is better than no compensation: duty cycle 2 alone is missed by" in said


def test_a_clock_is_no_place_for_a_sensor_and_candidates_are_listed(tmp_path, capsys):
    """A time that was not named as one could be chosen as a place: the error of a warm-up rises with it."""
    frame = pd.read_csv(field(tmp_path))
    frame["t"] = frame.groupby("duty_cycle").cumcount() * 60.0
    frame["error"] += 0.1 * frame["t"]
    frame.to_csv(tmp_path / "t.csv", index=False)
    code, document = asked(capsys, "place", str(tmp_path / "t.csv"))
    assert code == 0 and document["result"]["candidates"] == ["near", "wall", "far", "room"]
    assert document["result"]["clocks"] == ["t"] and "t" not in document["result"]["chosen"]


def test_an_empty_cell_is_named_with_its_line_and_a_file_of_semicolons_as_one(tmp_path, capsys):
    frame = pd.read_csv(field(tmp_path))
    frame.to_csv(tmp_path / "semi.csv", index=False, sep=";")
    assert main(["place", str(tmp_path / "semi.csv")]) == 3
    assert "between commas stand: duty_cycle;near" in capsys.readouterr().err
    frame.loc[3, "far"] = np.nan
    frame.to_csv(tmp_path / "gap.csv", index=False)
    assert main(["place", str(tmp_path / "gap.csv")]) == 3
    assert "gap.csv:5  far: is empty" in capsys.readouterr().err


def test_a_missing_column_is_named(tmp_path, capsys):
    code, document = asked(capsys, "place", str(field(tmp_path)), "--error", "eror")
    assert code == 3 and "no column 'eror'" in json.dumps(document)
    pd.read_csv(field(tmp_path)).rename(columns={"error": "growth"}).to_csv(tmp_path / "other.csv", index=False)
    assert main(["place", str(tmp_path / "other.csv")]) == 3
    assert "--error names the column of the error" in capsys.readouterr().err


@pytest.mark.parametrize(("column", "value"), [("error", "-1e400"), ("near", "inf"), ("far", "1.1e15")])
def test_an_impossible_number_is_refused_with_its_line(tmp_path, capsys, column, value):
    frame = pd.read_csv(field(tmp_path)).astype({column: object})
    frame.loc[7, column] = value
    frame.to_csv(tmp_path / "wild.csv", index=False)
    code, document = asked(capsys, "place", str(tmp_path / "wild.csv"))
    assert code == 3 and f"wild.csv:9  {column}: found " in json.dumps(document)


def test_the_heated_bar_of_the_paper_wants_its_sensor_near_035_of_its_length(capsys):
    """A line at each place beside a parabola at the same place: the best line is as good as the best parabola."""
    _, document = asked(capsys, "place", "--bar", "4")
    alone = {row["place"]: row for row in document["result"]["alone"]}
    best = min(alone, key=lambda n: alone[n]["line"])
    assert 0.3 <= float(best.split()[0]) <= 0.45
    assert alone[best]["line"] < 0.25 * alone["0.95 L"]["line"]
    assert alone[best]["line"] < 1.2 * min(row["parabola"] for row in alone.values())
    assert 0.3 < document["result"]["lag_free_place"] < 0.45


def test_a_day_is_planned_and_in_the_end_none_is_worth_it(tmp_path, capsys):
    code, document = asked(capsys, "plan-day", "--speed", "6000", "--hours", "4")
    day = document["result"]["day"]
    assert code == 0 and sum(step["minutes"] for step in day) == 240
    assert document["result"]["uncertainty_after_um"] < 0.2 * document["result"]["uncertainty_before_um"]
    run = np.repeat(np.arange(3), 240)
    t = np.tile(np.arange(240) * 60.0, 3)
    speeds = np.concatenate([np.repeat([s["rpm"] for s in day], [int(s["minutes"]) for s in day])] * 3)
    pd.DataFrame({"run": run, "t": t, "speed": speeds}).to_csv(tmp_path / "recording.csv", index=False)
    (tmp_path / "recording.yaml").write_text(
        "recording: 1\ncolumns:\n  run: {role: run}\n  t: {role: time, unit: s}\n"
        "  speed: {role: spindle_speed, unit: rpm}\ntables: [recording.csv]\n"
    )
    code, document = asked(capsys, "plan-day", str(tmp_path), "--hours", "4", "--noise", "1")
    assert code == 0 and document["result"]["days_done"] == 3 and not document["result"]["worth_it"]


def recording_of_days(path, kinds, gains=(4.0, -3.0)):
    """Days of which a letter says what warms: h the head, t the table."""
    rng = np.random.default_rng(3)
    parts = []
    for k, kind in enumerate(kinds):
        warm = 1.0 - np.exp(-np.arange(60) / 15.0)
        rises = np.outer(warm, [4.0 * (kind == "h"), 4.0 * (kind == "t")])
        y = rises @ (np.array(gains) + rng.normal(0, 0.3, 2)) + rng.normal(0, 0.3, 60)
        parts.append(
            pd.DataFrame(
                {"run": f"{kind}{k}", "cycle": {"h": "head", "t": "table"}[kind], "t": np.arange(60) * 300.0}
                | {"T_head": 20.0 + rises[:, 0], "T_table": 20.0 + rises[:, 1], "E": y}
            )
        )
    path.mkdir()
    pd.concat(parts).to_csv(path / "recording.csv", index=False)
    (path / "recording.yaml").write_text(
        "recording: 1\ncolumns:\n  run: {role: run}\n  cycle: {role: group, of: duty_cycle}\n"
        "  t: {role: time, unit: s}\n  T_head: {role: temperature, unit: degC, location: column}\n"
        "  T_table: {role: temperature, unit: degC, location: table}\n"
        "  E: {role: error, component: E_Z, unit: um}\ntables: [recording.csv]\n"
    )
    return str(path)


def test_of_a_log_the_duty_cycle_is_chosen_that_was_never_measured(tmp_path, capsys):
    recording, log = (recording_of_days(tmp_path / n, kinds) for n, kinds in (("days", "hhh"), ("log", "th")))
    code, document = asked(capsys, "plan-day", recording, "--log", log)
    result = document["result"]
    assert code == 0 and (result["measured"], result["runs"], result["next"]) == (3, 5, "table")
    table, head = result["candidates"]
    assert (table["duty_cycle"], table["runs"], table["measured"]) == ("table", 1, 0)
    assert (head["duty_cycle"], head["runs"], head["measured"]) == ("head", 4, 3)
    assert table["after"] < 0.4 * result["unknown_before"] and table["after"] < head["after"]
    _, document = asked(capsys, "plan-day", recording, "--log", log, "--least", "50")
    assert document["result"]["next"] is None and not document["result"]["worth_it"]


def test_after_enough_days_no_duty_cycle_is_worth_it(tmp_path, capsys):
    _, document = asked(capsys, "plan-day", recording_of_days(tmp_path / "days", "ht" * 12))
    assert document["result"]["next"] is None
    assert document["result"]["least"] == pytest.approx(0.3, rel=0.2)  # the noise of a reading


def test_deviations_over_an_axis_are_refused_because_planning_needs_temperatures(tmp_path, capsys):
    """What differs between places counted as what no run teaches, and nothing said so."""
    folder = tmp_path / "days"
    assert main(["plan-day", recording_of_days(folder, "hth")]) == 0
    assert "several places" not in capsys.readouterr().out
    frame = pd.read_csv(folder / "recording.csv")
    frame["x"] = np.arange(len(frame)) % 6 * 100.0
    frame["E"] += 0.05 * frame["x"]
    frame.to_csv(folder / "recording.csv", index=False)
    manifest = (folder / "recording.yaml").read_text(encoding="utf-8")
    manifest = manifest.replace("columns:\n", "columns:\n  x: {role: position, axis: X, unit: mm}\n")
    (folder / "recording.yaml").write_text(manifest, encoding="utf-8")
    assert main(["plan-day", str(folder)]) == 0
    assert "E_Z was measured at several places of X" in capsys.readouterr().out


def test_a_recording_without_temperatures_is_not_only_asked_for_speeds(tmp_path, capsys):
    folder = tmp_path / "days"
    recording_of_days(folder, "ht")
    text = (folder / "recording.yaml").read_text(encoding="utf-8")
    (folder / "recording.yaml").write_text(text.replace("role: temperature, unit: degC", "role: ignore"))
    assert main(["plan-day", str(folder)]) == 3
    assert "has neither an error with temperatures nor a spindle speed" in capsys.readouterr().err


def test_what_a_plan_of_errors_lacks_is_named(tmp_path, capsys):
    recording = recording_of_days(tmp_path / "days", "ht")
    code, document = asked(capsys, "plan-day", recording, "--component", "E_X")
    assert code == 3 and "no error 'E_X' (present: E_Z)" in json.dumps(document)
    code, document = asked(capsys, "plan-day", recording, "--by", "shift")
    assert code == 3 and "no group 'shift'" in json.dumps(document)


def test_a_row_without_a_duty_cycle_is_refused_with_its_line(tmp_path, capsys):
    path = field(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[6] = "," + lines[6].split(",", 1)[1]
    path.write_text("\n".join(lines), encoding="utf-8")
    assert main(["place", str(path)]) == 3
    assert f"{path}:7  duty_cycle: is empty" in capsys.readouterr().err
