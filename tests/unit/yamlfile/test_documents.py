"""YAML 1.2, places, refusals, environment, files, and pydantic's errors in plain words."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe.errors import ConfigError, UsageError
from errpipe.yamlfile import load, parse, plain, read
from tests.unit.yamlfile.written_models import Model, problems


@pytest.mark.parametrize(
    "text, value",
    [
        ("1e-3", 1e-3),
        ("no", "no"),
        ("on", "on"),
        ("12:30", "12:30"),
        ("2024-01-01", "2024-01-01"),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        ("+3", 3),
        ("-.5", -0.5),
        ("5.", 5.0),
        ("1_000", "1_000"),
        ("~", None),
        ("", None),
        ("TRUE", True),
        ("-.inf", float("-inf")),
        ("1" * 30, float("1" * 30)),
        ("0b1", "0b1"),
        ("e3", "e3"),
        ("<<", "<<"),
    ],
)
def test_plain_scalars_mean_what_yaml_1_2_says(text: str, value: object) -> None:
    rendered = plain(text)
    assert rendered == value and type(rendered) is type(value)


def test_quoted_scalars_are_texts() -> None:
    assert parse("[ '1', \"true\", |-\n 3\n]".replace("|-\n 3\n", "'3'")).value == ["1", "true", "3"]
    assert parse("a: |\n  7\n").value == {"a": "7\n"}


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "f.yaml:1:1  the file is empty"),
        ("# only a comment\n", "f.yaml:1:1  the file is empty"),
        (
            "a: 1\na: 2\nb: {c: 1, c: 2}",
            "f.yaml:2:1  a: duplicate key in one mapping (first in line 1)\n"
            "f.yaml:3:11  b.c: duplicate key in one mapping (first in line 3)",
        ),
        (
            "a: !!python/name:os.system x",
            "f.yaml:1:4  a: has the tag tag:yaml.org,2002:python/name:os.system (tags are not read)",
        ),
        ("a: 1\n---\nb: 2", "f.yaml:2:1  a second document starts here (one is allowed)"),
        ("%YAML 1.1\n---\na: 1", "f.yaml:2:1  asks for YAML 1.1 (1.2 is read)"),
        ("a: b: c", "f.yaml:1:5  not YAML: mapping values are not allowed here"),
        (
            "a: [1, 2",
            "f.yaml:1:9  not YAML: expected ',' or ']', but got '<stream end>', while parsing a flow sequence",
        ),
        ("a:\n\t- b", "f.yaml:2:1  not YAML: a tab is not allowed here (indent with spaces)"),
        ("a: \x07", "f.yaml:1:4  not YAML: the character U+0007 is not allowed"),
        ("? [a]\n: 1", "f.yaml:1:3  a key is a list, a mapping or an alias (a text is needed)"),
        ("a: *b", "f.yaml:1:4  a: the alias *b names nothing above."),
        ("a: &b [*b]", "f.yaml:1:8  a[0]: the alias *b is inside its own anchor"),
        ('a: "\\ud800"', "f.yaml:1:4  a: half of a surrogate pair is not a character"),
    ],
)
def test_what_is_not_plain_yaml_is_refused_with_its_place(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text, "f.yaml").validate(dict)
    assert str(caught.value) == message


def test_a_bomb_of_aliases_is_refused_before_it_goes_off() -> None:
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    steps = zip("abcdefgh", "bcdefghi", strict=True)
    lines += [f"{new}: &{new} [" + ", ".join([f"*{old}"] * 9) + "]" for old, new in steps]
    with pytest.raises(ConfigError, match="more than 200000 values"):
        parse("\n".join(lines))


def test_nesting_has_an_end() -> None:
    with pytest.raises(ConfigError, match="nested more than 40 levels deep"):
        parse("[" * 3000 + "]" * 3000)
    parse("[" * 39 + "1" + "]" * 39)


def test_aliases_are_copies() -> None:
    value = parse("a: &x {k: [1]}\nb: *x").value
    value["a"]["k"].append(2)
    assert value["b"] == {"k": [1]}


def test_all_problems_come_at_once_in_file_order() -> None:
    text = """\
version: 2
titel: Nine states
robust: no
count: 12
terms:
  - kind: lin
  - kind: line
    slope: -1
    lead: 10
  - kind: step
  - slope: 2
  - 7
limits:
  low: {kind: line, slope: a}
name: Green
"""
    assert problems(text) == [
        "f.yaml:1:10  version: found the number 2 (allowed: 1).",
        "f.yaml:2:1  titel: unknown key (allowed: version, title, robust, count, spread, terms, limits, name)."
        " Did you mean title?",
        "f.yaml:3:9  robust: found the text 'no' (true or false is needed). Did you mean false?",
        "f.yaml:4:8  count: 12 is not at most 9",
        "f.yaml:6:11  terms[0].kind: found 'lin' (allowed: line, step). Did you mean line?",
        "f.yaml:8:12  terms[1].slope: -1 is not above 0 um/m",
        "f.yaml:9:5  terms[1].lead: unknown key (allowed: kind, slope).",
        "f.yaml:10:5  terms[2].height: is missing (height of the step)",
        "f.yaml:11:5  terms[3].kind: is missing (allowed: line, step).",
        "f.yaml:12:5  terms[4]: found the number 7 (a mapping is needed)",
        "f.yaml:14:28  limits.low.slope: found the text 'a' (a number is needed)",
        "f.yaml:15:7  name: found 'Green' (allowed: red, green, blue). Did you mean green?",
    ]


@pytest.mark.parametrize(
    "text, message",
    [
        ("[1]", "f.yaml:1:1  found a list (a mapping is needed)"),
        (
            "version: 1\ncount: '3'",
            "f.yaml:2:8  count: found the text '3' (a whole number is needed). Did you mean 3, without quotes?",
        ),
        ("version: 1\ncount: 2.5", "f.yaml:2:8  count: found the number 2.5 (a whole number is needed)"),
        (
            "version: 1\ntitle: 5",
            "f.yaml:2:8  title: found the number 5 (a text is needed). Did you mean '5', in quotes?",
        ),
        (
            "version: 1\ntitle: true",
            "f.yaml:2:8  title: found true (a text is needed). Did you mean 'true', in quotes?",
        ),
        ("version: 1\ntitle:", "f.yaml:2:7  title: found nothing (a text is needed)"),
        ("version: 1\nspread: often", "f.yaml:2:9  spread: found the text 'often' (a number or one of auto is needed)"),
        ("version: 1\nspread: .nan", "f.yaml:2:9  spread: nan is not a finite number"),
        ("version: 1\nterms: {kind: line}", "f.yaml:2:8  terms: found a mapping (a list is needed)"),
        ("version: 1\nterms: [{kind: step, height: 1, sides: [1]}]", "f.yaml:2:33  terms[0].sides[1]: is missing"),
        (
            "version: 1\nterms: [{kind: step, height: 1, sides: [1, 1]}]",
            "f.yaml:2:44  terms[0].sides[1]: equals the first side",
        ),
        ("title: x", "f.yaml:1:1  version: is missing (1)"),
    ],
)
def test_single_problems(text: str, message: str) -> None:
    assert problems(text) == [message]


def test_what_is_missing_points_at_the_key_of_its_parent() -> None:
    assert problems("version: 1\nlimits:\n  low:\n    slope: 1\n") == ["f.yaml:3:3  limits.low.kind: is missing (line)"]


def test_variables_are_replaced_in_texts_only() -> None:
    environment = {"A": "x: 1\nlimit: 9999", "E": ""}
    text = "a: ${A}\nb: '${B:-../data}/${E:-e}'\nc: $${A} $5\n"
    assert parse(text, environment=environment).value == {"a": "x: 1\nlimit: 9999", "b": "../data/e", "c": "${A} $5"}
    assert parse(text).value["a"] == "${A}"


def test_an_undefined_variable_is_named_with_its_line() -> None:
    with pytest.raises(ConfigError) as caught:
        parse("a: 1\nb: ['${NOPE}', '${', '${1}']", "f.yaml", environment={}).validate(dict)
    assert str(caught.value).splitlines() == [
        "f.yaml:2:5  b[0]: the environment variable NOPE is not set (${NOPE:-default} would do without)",
        "f.yaml:2:16  b[1]: '${' is not followed by NAME} or NAME:-default}",
        "f.yaml:2:22  b[2]: '${' is not followed by NAME} or NAME:-default}",
    ]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "latin.yaml").write_bytes(b"a: 1\nb: caf\xe9\n")
    (tmp_path / "bom.yaml").write_bytes(b"\xef\xbb\xbfa: 1\n")
    (tmp_path / "big.yaml").write_bytes(b"# " + b"x" * 4_000_000)
    assert read(tmp_path / "bom.yaml").value == {"a": 1}
    for name, words in {
        "latin.yaml": "latin.yaml:2:7  not UTF-8 text (byte 0xe9)",
        "none.yaml": "none.yaml  no such file",
        "big.yaml": "big.yaml  has 4000002 bytes (at most 4000000 are read)",
        "": f"is needed: {tmp_path / 'big.yaml'}, {tmp_path / 'bom.yaml'}, {tmp_path / 'latin.yaml'})",
    }.items():
        with pytest.raises(ConfigError) as caught:
            load(tmp_path / name, Model)
        assert str(caught.value).endswith(words)


def test_values_can_be_assigned_and_keep_their_origin() -> None:
    document = parse("version: 1\nterms:\n  - kind: line\n", "f.yaml")
    document.assign(("terms", 0, "slope"), -1, "--set")
    document.assign(("limits", "low", "kind"), "line", "--set")
    with pytest.raises(ConfigError) as caught:
        document.validate(Model)
    assert str(caught.value) == "--set  terms[0].slope: -1 is not above 0 um/m"
    with pytest.raises(UsageError, match="terms is a list of 1; 4 is not one of its indices"):
        document.assign(("terms", 4, "slope"), 1, "--set")
    with pytest.raises(UsageError, match="version is the number 1, not a mapping"):
        document.assign(("version", "x"), 1, "--set")
