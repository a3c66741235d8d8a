"""Every output with `--json` has a schema and follows it; `tests/json_lines.py` checks the outputs of all tests."""

import json
import shlex
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
import pytest
from json_lines import check_lines, validator
from slide import SLIDE, write_csv

from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import commands, listings
from gauge_envs.cli.output import json_text
from gauge_envs.cli.schemas import output_schema, schema_names, schema_of

KINDS = [f"list {kind}" for kind in listings()]

HERE = {
    "list": "list SlopeSlider-2-wood FoamBending-soft",
    "show": "show RopeWinding-rubber",
    "run": "run SlopeSlider-2-wood FoamBending-soft -p measured",
    "score": "score slide.csv --id SlopeSlider-2-wood",
    "recipe fabrics": "recipe fabrics",
    "sanity": "sanity mujoco:out_of_box --only gravity,slide-wood",
    "backend check": "backend check mujoco --only free-fall",
    **{name: name for name in KINDS},
}
"""A fast command for each of these schemas."""

ELSEWHERE = {
    "compare": "tools/compare/test_comparison.py",
    "sweep": "tools/run/test_sweep_run.py",
    "replay": "tools/replay/test_logs.py",
    "recipe": "tools/recipes/test_recipe_requests.py",
    "backend versions": "tools/versions/test_versions.py",
    "data import": "tools/dataset/test_dataset_damage.py",
    "video score": "tools/video/test_video_score.py",
}
"""File with tests that run the command with `--json` in this process."""


def test_every_command_with_json_has_a_schema():
    formatted = {
        name
        for name in commands()
        if any("--format" in option.opts for option in load_command(name).params)
    }
    assert {*formatted, *KINDS, "result-file"} == set(schema_names())
    assert {*HERE, *ELSEWHERE, "result-file"} == set(schema_names())
    for file in ELSEWHERE.values():
        text = (Path(__file__).parents[1] / file).read_text()
        assert "--json" in text or "check_lines(" in text


@pytest.mark.usefixtures("rigid_only")
@pytest.mark.parametrize("command", HERE.values())
def test_an_output_follows_its_schema(gauge, tmp_path, command):
    write_csv(tmp_path / "slide.csv", SLIDE)
    assert gauge(*shlex.split(command), "--json").stdout.startswith("{")


def test_a_result_file_follows_its_schema(gauge, tmp_path):
    gauge("run", "SlopeSlider-2-wood", "--out", tmp_path)
    (file,) = tmp_path.glob("*.json")
    check_lines("result-file", file.read_text())


# --- values that a schema rejects ---


def test_no_object_of_a_schema_allows_further_keys():
    def objects(schema):
        if isinstance(schema, dict):
            yield from [schema] if "properties" in schema else []
            for value in schema.values():
                yield from objects(value)
        elif isinstance(schema, list):
            for value in schema:
                yield from objects(value)

    count = 0
    for name in schema_names():
        validator(name)
        for entry in objects(output_schema(name)):
            assert entry.get("additionalProperties") is False
            count += 1
    assert count > 80


# --- types ---


class Part(TypedDict):
    """A part.

    Attributes:
        size: Its size [m].
    """

    size: float


@dataclass(frozen=True)
class Whole:
    """A whole."""

    parts: tuple[Part, ...]
    ends: tuple[float, int] | None
    name: str | None = None


def test_a_schema_follows_from_a_type():
    whole = schema_of(Whole)
    part = whole["properties"]["parts"]["items"]
    assert part["properties"]["size"] == {
        "type": ["number", "null"],
        "description": "Its size [m].",
    }
    assert whole["required"] == ["parts", "ends", "name"]
    assert whole["properties"]["name"] == {"type": ["string", "null"]}
    assert whole["properties"]["ends"]["anyOf"][0]["minItems"] == 2
    for unsupported in (bytes, set[complex], complex):
        with pytest.raises(TypeError, match="no JSON Schema"):
            schema_of(unsupported)


def test_json_takes_every_number():
    values = {
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "number": np.float32("inf"),
        "count": np.int64(3),
        "truth": np.True_,
        "text": "Würfel\ud800\x1b",
        "nested": [{"deep": (np.float64("nan"), None)}],
    }
    text = json_text([deepcopy(values)])
    assert json.loads(text, parse_constant=pytest.fail) == {
        "array": [[1.0, None], [None, 2.0]],
        "number": None,
        "count": 3,
        "truth": True,
        "text": "Würfel\ud800\x1b",
        "nested": [{"deep": [None, None]}],
    }
    assert text.isascii()


# --- the command ---


def test_the_command_prints_the_schema(gauge):
    shown = json.loads(gauge("show", "backend check", "--schema").stdout)
    assert shown == output_schema("backend check")
    assert shown["$id"] == "urn:gauge-envs:backend-check:5"
    unknown = gauge("show", "lst", "--schema")
    assert (unknown.exit_code, unknown.stdout) == (2, "")
    assert "did you mean list?" in unknown.stderr
