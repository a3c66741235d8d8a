"""JSON lines of `gauge recipe` and `gauge list materials`."""

from collections.abc import Mapping
from typing import Annotated, NotRequired, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.recipes.materials import MaterialPair
from gauge_envs.tools.recipes.search import Recipe


class Subject(TypedDict):
    """Subject of a request by name.

    Attributes:
        material: The requested pair, or the name of the fabric.
    """

    material: NotRequired[MaterialPair | str]


RecipeLine = Annotated[Recipe, Form(more=Subject)]
"""A line of `gauge recipe`."""

FabricsLine = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Constants by fabric, engine and name."""


class FabricFacts(TypedDict):
    """A measured fabric.

    Attributes:
        name: Name of the fabric.
        stretch: Stretch stiffness [N/m].
        shear: Shear stiffness [N/m].
        bend: Bending stiffness [N m/rad].
        density: Areal density [kg/m^2].
        length: Bending length [m].
    """

    name: str
    stretch: float
    shear: float
    bend: float
    density: float
    length: float


MaterialLine = MaterialPair | FabricFacts
"""A measured pair, or a fabric."""
