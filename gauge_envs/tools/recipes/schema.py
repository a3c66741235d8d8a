"""JSON lines of `gauge recipe` and `gauge list materials`."""

from collections.abc import Mapping
from typing import Annotated, NotRequired, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.recipes.materials import MaterialPair
from gauge_envs.tools.recipes.search import Recipe


class RecipeSubject(TypedDict):
    """Subject of a request by name.

    Attributes:
        material: The requested pair, or the name of the fabric.
    """

    material: NotRequired[MaterialPair | str]


RecipeLine = Annotated[Recipe, Form(more=RecipeSubject)]
"""A line of `gauge recipe`."""

FabricsLine = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Constants by fabric, engine and name."""


MaterialLine = MaterialPair
"""A measured pair."""
