"""A choice of models that loads what a text names, and texts of any kind."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field, create_model

from errpipe.errors import ConfigError, UsageError
from errpipe.yamlfile import Choice, Options, parse
from tests.unit.yamlfile.written_models import Model

_BITS = st.sampled_from(
    [
        "a",
        "kind",
        ": ",
        ":",
        "- ",
        "\n",
        "\n  ",
        "[",
        "]",
        "{",
        "}",
        ", ",
        "&x ",
        "*x",
        "!!t ",
        "'",
        '"',
        "|",
        ">",
        "#",
        "---\n",
        "%YAML 1.1\n",
        "1e-3",
        "~",
        "\t",
        "? ",
        "<<: ",
        "${A}",
        "version: 1\n",
        "terms:\n",
        "\ufeff",
        "\x00",
        "ü",
        "@",
        "`",
        "...",
    ]
)


@settings(deadline=None)
@given(st.lists(_BITS, max_size=25).map("".join))
def test_whatever_is_written_is_read_or_refused(text: str) -> None:
    try:
        document = parse(text, "f.yaml", environment={})
        document.validate(Model)
    except ConfigError as err:
        assert err.problems and all(problem.message for problem in err.problems)


def _choice(loaded: list[str]) -> Any:
    def load(tag: str, **fields: Any) -> Any:
        loaded.append(tag)
        return create_model(tag, __base__=Options, kind=(Literal[tag], tag), **fields)

    return Choice(
        "kind",
        {
            "one": lambda: load("one", size=(float, Field(gt=0, json_schema_extra={"unit": "mm"}))),
            "two": lambda: load("two", names=(tuple[str, ...], ())),
        },
    )


def test_a_choice_loads_what_is_named_and_nothing_else() -> None:
    loaded: list[str] = []
    model: Any = create_model("File", parts=(tuple[_choice(loaded), ...], ()))
    parsed = parse("parts: [{kind: one, size: 2 cm}]").validate(model)
    assert parsed.parts[0].size == 20.0 and loaded == ["one"]
    assert parsed.model_dump(mode="json") == {"parts": [{"kind": "one", "size": 20.0}]}
    assert set(model.model_json_schema()["$defs"]) == {"one", "two"}


def test_errors_inside_a_choice_have_their_place_and_what_is_allowed() -> None:
    model: Any = create_model("File", parts=(tuple[_choice([]), ...], ()))
    text = "parts:\n- {kind: one, size: -1}\n- {kind: two, name: x}\n- {kind: tow}\n- {kind: two, names: [1]}\n- {}\n"
    with pytest.raises(ConfigError) as caught:
        parse(text).validate(model)
    said = [str(problem).split("  ", 1)[1] for problem in caught.value.problems]
    assert said == [
        "parts[0].size: -1 is not above 0 mm",
        "parts[1].name: unknown key (allowed: kind, names). Did you mean names?",
        "parts[2].kind: found 'tow' (allowed: one, two). Did you mean two?",
        "parts[3].names[0]: found the number 1 (a text is needed). Did you mean '1', in quotes?",
        "parts[4].kind: is missing (allowed: one, two).",
    ]


@pytest.mark.parametrize(
    ("files", "text", "message"),
    [
        (
            ("pear", "pear"),
            'class Pear(BaseModel):\n    kind: Literal["pear"] = "pear"\n',
            r"__init__.py lists 'pear' twice",
        ),
        (("plum",), "", r"__init__.py lists 'plum', and there is no fruits/plum.py"),
        (("pear",), "class Pair: ...\n", r"fruits/pear.py holds no class Pear: the class of a file is named after it"),
        (
            ("pear",),
            'class Pear(BaseModel):\n    kind: Literal["fig"] = "fig"\n',
            r"fruits/pear.py: Pear.kind says 'fig', its registry 'pear'",
        ),
    ],
)
def test_a_registry_that_does_not_fit_its_files_says_how(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: tuple[str, ...], text: str, message: str
) -> None:
    (tmp_path / "fruits").mkdir()
    head = "from typing import Literal\nfrom pydantic import BaseModel\n\n\n"
    (tmp_path / "fruits" / "pear.py").write_text(head + text)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("fruits", "fruits.pear"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(UsageError, match=message):
        list(Choice.of_files("fruits", "kind", files))
