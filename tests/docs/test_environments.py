"""Pages of families and `gauge show`: they have every id, fit the screen, and describe the environments."""

import json

import gymnasium
import numpy as np
import pytest
from places import ROOT
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.experiments.variants import beyond_variants, matching_variants, variants
from gauge_envs.tools.catalog.description import all_limits
from gauge_envs.tools.catalog.spaces import observation_rows
from gauge_envs.tools.control import names
from scripts.environment_page import note_of

PAGES = ROOT / "docs" / "environments"
VARIANTS = (*variants(), *beyond_variants())
MAX_LINES, WIDTH = 50, 100


def shown(*arguments):
    result = CliRunner(env={"COLUMNS": str(WIDTH)}).invoke(app, ["show", *arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


# --- every id --------------------------------------------------------------------------------------------------------


def test_every_registered_experiment_has_a_page_that_names_it():
    controls = {f"GAUGE/{name}" for name in names()}
    ids = {name for name in gymnasium.registry if name.startswith("GAUGE/")} - controls
    assert ids == {variant.id for variant in VARIANTS}
    absent = []
    for variant in VARIANTS:
        page = (PAGES / f"{variant.family}.md").read_text()
        if f"`{variant.name}`" not in page:
            absent.append(variant.id)
    assert absent == []


@pytest.mark.parametrize(
    "name",
    [
        "SlopeSlider-2-wood",
        "TextileFlinging-satin",
        "RopeWinding-rubber",
        "CubeToss-acrylic",
        "Throw-Limit-rubber",
    ],
)
def test_an_id_is_shown_on_a_screen(name):
    lines = shown(name).splitlines()
    assert len(lines) <= MAX_LINES
    assert max(map(len, lines)) <= WIDTH
    (values,) = (json.loads(line) for line in shown(name, "--json").splitlines())
    assert values["id"] == f"GAUGE/{name}"


# --- behaviour of an environment -------------------------------------------------------------------------------------


def part(observation, name):
    """Return the part of an observation with a name, as `bodies[:, 0:3]`."""
    key, _, columns = name.partition("[:, ")
    first, last = map(int, columns.rstrip("]").split(":")) if columns else (None, None)
    return observation[key][:, first:last] if columns else observation[key]


@pytest.mark.parametrize(
    "name",
    ["SlopeSlider-2-wood", "Turntable-1-wood", "StickStack-soft", "CubeToss-acrylic"],
)
def test_rows_of_spaces_describe_observations(name):
    env = GaugeEnv(name)
    observation, _ = env.reset(seed=0)
    rows = observation_rows(env.experiment)
    for row in rows:
        values = part(observation, row["name"])
        assert list(values.shape) == row["shape"]
        assert np.isnan(row["low"]) or (
            (row["low"] <= values).all() and (values <= row["high"]).all()
        )
    named = {
        key: sum(row["shape"][-1] for row in rows if row["entry"] == key)
        for key in observation
    }
    assert named == {key: values.shape[-1] for key, values in observation.items()}
    env.close()


# --- limits ----------------------------------------------------------------------------------------------------------


def test_limits_are_of_known_variants_and_studies():
    for limit in all_limits():
        assert [
            pattern for pattern in limit["variants"] if not matching_variants(pattern)
        ] == []
        if "study" not in limit:
            continue
        assert (ROOT / "studies" / note_of(limit["study"]).partition("#")[0]).is_file()
