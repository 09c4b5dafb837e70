"""The reference pages in `docs/` are what the code says today, complete, and their examples hold."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from errpipe import yamlfile
from errpipe.domain.recording import Manifest
from errpipe.errors import UsageError
from errpipe.pipeline.spec import load_pipeline
from errpipe.stages import STAGES
from errpipe.verbs import reference

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("name", reference.PAGES)
def test_the_page_is_up_to_date(name: str) -> None:
    written = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert written == reference.page(name), "run `make generated`"


def ids(package: str, registry: str) -> list[str]:
    out = []
    for plug_in in getattr(import_module(f"errpipe.{package}"), registry):
        key = {"terms": "term", "stages": "kind"}.get(package)
        out.append(plug_in.name if key is None else plug_in.model_fields[key].annotation.__args__[0])
    return out


@pytest.mark.parametrize(
    "package, registry", [("terms", "TERMS"), ("formats", "FORMATS"), ("targets", "TARGETS"), ("stages", "STAGES")]
)
def test_every_plug_in_has_an_entry(package: str, registry: str) -> None:
    page = reference.page(package)
    for name in ids(package, registry):
        assert re.search(rf"^## `{name}`(, `\w+: \w+`)?$", page, re.M)
        assert reference.entry(package, name).startswith(f"## `{name}`")


def test_every_effect_states_equation_assumptions_sizes_sign_and_source() -> None:
    from errpipe.terms import TERMS

    for term in TERMS:
        words = {word for word, _ in reference.sections(term.__doc__ or "")[1]}
        wanted = {"Equation", "Assumes", "Source"} | ({"Typical", "Moves"} if term.reports_as else set())
        assert wanted <= words, f"{term.__name__} does not state {sorted(wanted - words)}"


def example(name: str) -> str:
    return re.search(r"```yaml\n(.*?)```", reference.page(name), re.S).group(1)  # type: ignore[union-attr]


@pytest.mark.parametrize("name", [n for n in reference.PAGES if n != "recordings"])
def test_the_example_of_a_page_is_a_valid_part_of_a_pipeline(name: str, tmp_path: Path) -> None:
    text = example(name)
    if not text.startswith("pipeline:"):
        fitted = "  - {kind: fit, components: [{component: EXX, terms: [{term: offset}]}]}\n"
        before = "" if "kind: ingest" in text else "  - {kind: simulate}\n  - {kind: ingest}\n" + fitted
        text = "pipeline: 1\ntitle: example\n" + text.replace("stages:\n", f"stages:\n{before}")
    (tmp_path / "p.yaml").write_text(text, encoding="utf-8")
    assert load_pipeline(tmp_path / "p.yaml", STAGES, sets=[]).stages


def test_the_example_of_recordings_is_a_valid_manifest(tmp_path: Path) -> None:
    (tmp_path / "recording.yaml").write_text(example("recordings"), encoding="utf-8")
    load_result: Any = yamlfile.load(tmp_path / "recording.yaml", Manifest)
    assert load_result.columns["EXX"].component == "EXX"


def test_a_misspelt_entry_names_the_nearest() -> None:
    with pytest.raises(UsageError, match="Did you mean backlash"):
        reference.entry("terms", "backlsh")


def test_the_entry_of_a_stage_has_each_of_its_variants() -> None:
    variants = [s for s in STAGES if s.model_fields["kind"].annotation.__args__[0] == "fit"]
    assert len(variants) > 5
    names = {f"`{s.variant_key}: {s.model_fields[s.variant_key].default}`" for s in variants}
    text = reference.entry("stages", "fit")
    assert [name for name in sorted(names) if name not in text] == []
