"""What `gauge recipe` and `gauge list materials` print with `--json`, a line each."""

from collections.abc import Mapping, Sequence
from typing import Any, NotRequired, TypedDict

from gauge_envs.tools.recipes.materials import MaterialPair

Numbers = Mapping[str, float]


class RecipeLine(TypedDict):
    """Settings of an engine for a contact or a fabric, and what they reach in simulation.

    Attributes:
        engine: Name of the engine.
        asked: What was asked, by name; null for what was not.
        settings: Settings of the engine.
        snippet: The same in the engine's own language.
        reached: Measured values by name.
        error: Reached less asked values.
        misses: Names of the asked values that are not reached.
        detail: What the reached values leave out.
        wall_s: Wall time of the simulations [s].
        explanation: Why a value is not reached.
        versions: Versions of the engine's packages.
        material: The measured pair that was asked for, or the name of the fabric.
    """

    engine: str
    asked: Numbers
    settings: Mapping[str, Any]
    snippet: str
    reached: Numbers
    error: Numbers
    misses: Sequence[str]
    detail: Mapping[str, Any]
    wall_s: float
    explanation: str
    versions: Mapping[str, str]
    material: NotRequired[MaterialPair | str]


class MeaningLine(TypedDict):
    """What given settings of a contact mean, with `--explain`.

    Attributes:
        engine: Name of the engine.
        asked: Mass of the body [kg] and time step [s].
        settings: Settings of the engine.
        snippet: The same in the engine's own language.
        reached: Measured values by name.
        closed_form: What formulas give, by name; null where there are none.
        explanation: What limits the values.
        versions: Versions of the engine's packages.
    """

    engine: str
    asked: Numbers
    settings: Mapping[str, Any]
    snippet: str
    reached: Numbers
    closed_form: Mapping[str, Any] | None
    explanation: str
    versions: Mapping[str, str]


Recipe = RecipeLine | MeaningLine
"""A line of `gauge recipe`."""

FabricsLine = Mapping[str, Mapping[str, Numbers]]
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
