"""Environments write out their options: an editor shows each with its type, and `help` with its text and unit."""

import inspect
from dataclasses import MISSING, fields

import pytest

from gauge_envs import GaugeEnv
from gauge_envs.cli.schemas import descriptions
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.envs.vector import GaugeVectorEnv
from gauge_envs.tools.control import ControlEnv

PICTURE = {"render_mode", "width", "height", "camera", "render_overlay"}
"""Options of pictures."""

OWN = {
    GaugeEnv: PICTURE | {"jitter"},
    GaugeVectorEnv: PICTURE
    | {"jitter", "num_envs", "world_parameters", "autoreset_mode"},
}
"""Options of each class that are not arguments of an episode's run."""

UNITS = {
    "width": "[pixels]",
    "height": "[pixels]",
    "camera": "[m]",
    "render_mode": "[m]",
}
"""Unit of each option with a quantity."""


def options_of(cls):
    return inspect.signature(cls, eval_str=True).parameters


@pytest.mark.parametrize("cls", [GaugeEnv, GaugeVectorEnv, ControlEnv])
def test_each_option_has_a_type_and_a_text(cls):
    described = descriptions(cls, "Args")
    options = options_of(cls)
    assert described.keys() == options.keys()
    for name, option in options.items():
        assert option.kind is not inspect.Parameter.VAR_KEYWORD
        assert option.annotation is not inspect.Parameter.empty
        assert len(described[name].split()) >= 3


def test_the_text_of_a_quantity_has_its_unit():
    described = descriptions(GaugeEnv, "Args")
    assert {name for name, unit in UNITS.items() if unit in described[name]} == {*UNITS}


@pytest.mark.parametrize("cls", OWN)
def test_the_options_are_those_of_an_episode(cls):
    options = options_of(cls)
    assert options.keys() - OWN[cls] == {field.name for field in fields(EnvArguments)}
    for field in fields(EnvArguments):
        assert options[field.name].annotation == field.type
        if field.default is not MISSING:
            assert options[field.name].default == field.default
