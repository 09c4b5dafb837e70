"""The published JSON Schemas are those of the code, are draft-07, say units, and accept what errpipe accepts."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from errpipe import jsonfile, yamlfile
from errpipe.cli.schema import MODELS, schema_of
from errpipe.domain.machine import Machine
from errpipe.pipeline.schema import properties
from errpipe.pipeline.spec import load_pipeline
from errpipe.stages import STAGES

ROOT = Path(__file__).parents[2]
REAL_DATA = Path(os.environ.get("ERRPIPE_REAL_DATA", ROOT / "../shared/real-data"))
TRIALS = ROOT / "../shared/blind-trials"


def accepts(schema: dict[str, Any], path: Path) -> list[str]:
    """What a draft-07 validator says of a YAML file."""
    value = yamlfile.read(path, environment=os.environ).value
    return [error.message for error in jsonschema.Draft7Validator(schema).iter_errors(value)]


@pytest.mark.parametrize("name", MODELS)
def test_the_file_is_what_the_code_says(name: str) -> None:
    path = ROOT / "schemas" / f"{name}.schema.json"
    assert path.read_text() == jsonfile.dumps(schema_of(name)), "run `make generated` and read the difference"


@pytest.mark.parametrize("name", MODELS)
def test_it_is_draft_07_and_every_reference_leads_somewhere(name: str) -> None:
    schema = schema_of(name)
    jsonschema.Draft7Validator.check_schema(schema)
    text = jsonfile.dumps(schema)
    assert "$defs" not in text and "prefixItems" not in text and "discriminator" not in text
    definitions = schema.get("definitions", {})

    def references(node: Any) -> list[str]:
        if isinstance(node, list):
            return [entry for part in node for entry in references(part)]
        if not isinstance(node, dict):
            return []
        assert "$ref" not in node or len(node) == 1, f"beside a $ref draft-07 reads nothing: {node}"
        own = [node["$ref"]] if isinstance(node.get("$ref"), str) else []
        return own + [entry for part in node.values() for entry in references(part)]

    assert {entry.removeprefix("#/definitions/") for entry in references(schema)} <= set(definitions)


def undescribed(schema: Mapping[str, Any]) -> list[str]:
    """`Model.key` of every property without a description, or with a number but no unit (`1`: a pure number).

    Whole numbers count things or number a version and need no unit; where one has a unit it is said all the same.
    """
    problems = []
    for owner, name, prop in properties(schema):
        if not prop.get("description"):
            problems.append(f"{owner}.{name}: no description")
        if _has_number(prop) and "unit" not in prop:
            problems.append(f"{owner}.{name}: a number without a unit (`errpipe.yamlfile.quantity` states one)")
    return problems


def _has_number(prop: Mapping[str, Any]) -> bool:
    inner = [prop.get("items"), prop.get("additionalProperties"), *prop.get("anyOf", ())]
    inner += prop["items"] if isinstance(prop.get("items"), list) else []
    return prop.get("type") == "number" or any(_has_number(part) for part in inner if isinstance(part, dict))


@pytest.mark.parametrize("name", MODELS)
def test_every_key_says_what_it_means_and_in_which_unit(name: str) -> None:
    assert undescribed(schema_of(name)) == []


def test_the_engine_s_own_keys_are_described() -> None:
    stages = {stage.__name__ for stage in STAGES}
    keys = ("pipeline", "title", "root", "stages", "name", "from")
    own = [f"{owner}.{key}:" for owner in ("", *stages) for key in keys]
    assert [text for text in undescribed(schema_of("pipeline")) if text.startswith(tuple(own))] == []


@pytest.mark.parametrize("path", sorted((ROOT / "pipelines").glob("*.yaml")), ids=lambda path: path.stem)
def test_pipelines_are_accepted(path: Path) -> None:
    assert accepts(schema_of("pipeline"), path) == []


@pytest.mark.parametrize("path", sorted((ROOT / "examples" / "machines").glob("*.yaml")), ids=lambda path: path.stem)
def test_machines_are_accepted(path: Path) -> None:
    assert accepts(schema_of("machine"), path) == []


@pytest.mark.realdata
@pytest.mark.parametrize("folder", [REAL_DATA, TRIALS], ids=["real", "trials"])
def test_manifests_are_accepted(folder: Path) -> None:
    paths = sorted(folder.glob("*/recording.yaml"))
    if not paths:
        pytest.skip("the recordings are not beside the project (ERRPIPE_REAL_DATA)")
    for path in paths:
        assert accepts(schema_of("recording"), path) == [], path.parent.name


def test_a_wrong_pipeline_is_reported_for_the_branch_that_was_meant() -> None:
    value = {"pipeline": 1, "stages": [{"kind": "ingest", "recordin": "x"}]}
    errors = list(jsonschema.Draft7Validator(schema_of("pipeline")).iter_errors(value))
    assert [error.message.split(" (")[0] for error in errors] == ["Additional properties are not allowed"]
    value = {"pipeline": 1, "stages": [{"kind": "ingst"}]}
    (error,) = jsonschema.Draft7Validator(schema_of("pipeline")).iter_errors(value)
    assert "'ingst' is not one of" in error.message


PIPELINE = """
pipeline: 1
stages:
  - {kind: ingest, recording: here}
  - kind: fit
    components:
      - component: E_Z
        terms:
          - {term: profile_driver, axis: X, driver: [{input: T, lag: true, tau: [60 s, 50 min]}]}
"""
MACHINE = """
machine: 1
name: lathe
chain: [workpiece, bed, X, tool]
axes: {X: {kind: linear, travel: [0, 200], reference: [1 m, 20 um, 0]}}
tool: {length: 12 cm}
"""


@pytest.mark.parametrize("name, text", [("pipeline", PIPELINE), ("machine", MACHINE)])
def test_numbers_with_their_unit_are_accepted_by_schema_and_code(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(text)
    assert accepts(schema_of(name), path) == []
    read = load_pipeline(path, STAGES) if name == "pipeline" else yamlfile.load(path, Machine)
    if name == "pipeline":
        assert read.stages[1].components[0].terms[0].driver[0].tau == (60.0, 3000.0)
    else:
        assert read.axes["X"].reference == (1000.0, 0.02, 0.0) and read.tool.length == 120.0
