"""What `gauge recipe` and `gauge list materials` print with `--json`, a line each."""

from collections.abc import Mapping
from typing import Annotated, NotRequired, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.tools.recipes.explain import Meaning
from gauge_envs.tools.recipes.materials import MaterialPair
from gauge_envs.tools.recipes.search import Recipe


class Subject(TypedDict):
    """What was asked for by name.

    Attributes:
        material: The measured pair that was asked for, or the name of the fabric.
    """

    material: NotRequired[MaterialPair | str]


RecipeLine = Annotated[Recipe, Form(more=Subject)] | Meaning
"""A line of `gauge recipe`."""

FabricsLine = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Constants by fabric, engine and name."""


class PublishedPair(TypedDict):
    """Friction of a pair of materials from a table, as it is printed there."""

    name: str
    static: str
    dynamic: str
    rolling_mm: str
    source: str


class FabricFacts(TypedDict):
    """A measured fabric.

    Attributes:
        name: Name of the fabric.
        stretch: Stiffness of stretching [N/m].
        shear: Stiffness of shear [N/m].
        bend: Stiffness of bending [N m/rad].
        density: Areal density [kg/m^2].
        length: Bending length [m].
    """

    name: str
    stretch: float
    shear: float
    bend: float
    density: float
    length: float


MaterialLine = MaterialPair | PublishedPair | FabricFacts
"""A measured pair, a pair of a table, or a fabric."""
