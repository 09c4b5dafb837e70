"""The generator: repeatable, valid, fair and tight-lipped."""

import csv
import json
import re

import numpy as np
import pytest

from errpipe.formats import manifest_folder
from tests.unit.trials.folders import assert_same_files
from trials.first.assemble import MOSTLY_EXPLAINED, TIERS
from trials.first.generate import MIX, PROTOCOLS, generate, occurring, one_case, plan
from trials.score import sealed_answers

EFFECTS = 36


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    out = tmp_path_factory.mktemp("trials") / "drawn"
    generate(out, seed=3, cases=30)
    return out


@pytest.mark.slow
def test_same_seed_same_bytes(tmp_path):
    for name in ("one", "other"):
        generate(tmp_path / name, seed=3, cases=8)
    assert_same_files(tmp_path / "one", tmp_path / "other", count=8 * 3 + 1)


@pytest.mark.slow
def test_another_seed_draws_other_cases(drawn, tmp_path):
    ids = generate(tmp_path / "other", seed=4, cases=3, tiers=["plain"])
    assert not {p.name for p in (drawn / "cases").iterdir()} & set(ids)


def test_every_effect_of_the_vocabulary_can_be_hidden():
    assert len(occurring()) == EFFECTS


def test_a_full_set_hides_every_effect_in_every_tier_mix():
    drawn = plan(7, 130, list(MIX), None, list(PROTOCOLS))
    assert {effect for _, effect, _ in drawn if effect} == set(occurring())
    assert {tier for tier, _, _ in drawn} == set(TIERS)


def test_every_manifest_is_read_by_errpipe(drawn):
    for folder in sorted((drawn / "cases").iterdir()):
        recording = manifest_folder.read(folder)
        assert len(recording.frame) > 200


def test_the_folder_gives_nothing_away(drawn):
    words = "hidden|truth|missing|novel|concealed|plain|partial|answer"
    for folder in sorted((drawn / "cases").iterdir()):
        assert {p.name for p in folder.iterdir()} == {"recording.yaml", "recording.csv"}
        manifest = (folder / "recording.yaml").read_text()
        key = json.loads((drawn / "answers" / f"{folder.name}.json").read_text())
        assert not re.search(words, manifest)
        for response in key["responses"].values():
            for name in response["truth"]:
                assert name not in manifest


def test_the_oracle_reaches_the_noise(drawn):
    for key in sealed_answers(drawn):
        for response in key["responses"].values():
            assert response["oracle_after_rms"] <= 1.15 * response["noise_rms"]


def test_keys_say_what_the_public_sample_says(drawn):
    fields = {
        "unit",
        "verdict",
        "effects",
        "truth",
        "drivers",
        "where",
        "params",
        "before_rms",
        "oracle_after_rms",
        "noise_rms",
        "in_the_simulation",
    }
    for key in sealed_answers(drawn):
        assert set(key) == {"case", "tier", "protocol", "responses"}
        for response in key["responses"].values():
            assert set(response) == fields
            assert all(0.85 <= g <= 1.15 for g in response["in_the_simulation"].values())
            for group, truth in zip(response["effects"], response["truth"], strict=True):
                assert group[0] == truth or truth.startswith("outside the vocabulary")
            assert not set(response["truth"]) & set(response["in_the_simulation"])
            if len(response["effects"]) == 2:
                assert not set(response["effects"][0]) & set(response["effects"][1])
        missing = [r for r in key["responses"].values() if r["effects"]]
        assert len(missing) == (0 if key["tier"] == "null" else 1)


def test_the_mismatch_is_what_the_key_says(drawn):
    for key in sealed_answers(drawn):
        with open(drawn / "cases" / key["case"] / "recording.csv", newline="") as stream:
            rows = list(csv.DictReader(stream))
        for component, response in key["responses"].items():
            pairs = [(r[component], r[f"{component}_sim"]) for r in rows if r[component]]
            gap = np.array([float(a) - float(b) for a, b in pairs])
            wild = np.abs(gap - np.median(gap)) > 6 * response["before_rms"]
            assert wild.mean() < 0.04
            assert np.sqrt(np.mean(gap[~wild] ** 2)) == pytest.approx(response["before_rms"], rel=0.35)


@pytest.mark.parametrize("tier", ["plain", "concealed"])
def test_hidden_effects_have_the_size_of_their_tier(tier):
    for number in range(5):
        _, bench, stories, _ = one_case(11, number, tier, None, list(PROTOCOLS))
        story = next(s for s in stories if s.hidden)
        rest = np.zeros(bench.rows)
        for c, gain in zip(story.included, story.gains, strict=True):
            rest += (1 - gain) * c.values
        size, rest = story.hidden[0].rms(bench.measured), np.std(rest[bench.measured])
        if tier == "plain":
            assert 1.9 <= size / story.noise <= 5.1
            assert rest <= 1.01 * size
        else:
            assert 0.49 <= size / rest <= 1.01


def test_no_textbook_effect_explains_a_mechanism_outside_the_vocabulary():
    from trials.first.lookalikes import compare

    for number in range(4):
        _, bench, stories, _ = one_case(12, number, "novel", None, list(PROTOCOLS))
        story = next(s for s in stories if s.hidden)
        none = np.zeros((bench.rows, 0))
        comparison = compare(bench, story.response.component, story.hidden[0], none, story.noise, bench.measured, False)
        assert comparison.best[1] <= MOSTLY_EXPLAINED
