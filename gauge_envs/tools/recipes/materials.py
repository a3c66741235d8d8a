"""Pairs of materials whose friction and restitution were measured, with source and uncertainty.

All numbers are those of the task files; none stands here.
"""

import csv
from collections.abc import Iterable
from dataclasses import dataclass

from gauge_envs.errors import UnknownNameError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.references import uncertainties
from gauge_envs.references.tables import read_content, scoring_folder


@dataclass(frozen=True, kw_only=True)
class MaterialPair:
    """Measured contact of two materials.

    Attributes:
        name: Name, as `wood-on-wood`.
        what: The two bodies.
        friction: Coefficient of friction; None if none was measured.
        friction_std: Standard uncertainty of `friction`; None if none is published.
        restitution: Coefficient of restitution.
        restitution_std: Standard uncertainty of `restitution`; None if none is published.
        mass_kg: Mass of the real body [kg].
        source: Where the numbers come from.
        uncertainty_sources: Where each uncertainty comes from.
    """

    name: str
    what: str
    friction: float | None
    friction_std: float | None
    restitution: float
    restitution_std: float | None
    mass_kg: float
    source: str
    uncertainty_sources: tuple[str, ...]


PAIRS = {
    "wood-on-wood": ("wood cube on a tilted wooden board", "SlopeSlider", "cube"),
    "plastic-on-wood": ("plastic cube on a tilted wooden board", "SlopeSlider", "cube"),
    "metal-on-wood": ("metal cube on a tilted wooden board", "SlopeSlider", "cube"),
    "wood-on-wood-plate": ("wood cube on a turning wooden plate", "Turntable", "cube"),
    "plastic-on-wood-plate": (
        "plastic cube on a turning wooden plate",
        "Turntable",
        "cube",
    ),
    "metal-on-wood-plate": (
        "metal cube on a turning wooden plate",
        "Turntable",
        "cube",
    ),
    "wood-on-wood-block": (
        "wooden tetrahedron on the seam of a wooden block",
        "SlopeContact",
        "teh",
    ),
    "plastic-on-plastic-block": (
        "plastic tetrahedron on the seam of a plastic block",
        "SlopeContact",
        "teh",
    ),
    "rubber-on-wood": ("rubber ball on a wooden plank", "BouncingBall", "ball"),
    "rubber-on-wood-recorded": (
        "rubber ball on a wooden plank, restitution of the recorded drops",
        "BouncingBall",
        "ball",
    ),
    "metal-on-metal": ("balls of a cradle", "NewtonsCradle", "ball-1"),
    "metal-on-metal-recorded": (
        "balls of a cradle, restitution that transfers the recorded momentum",
        "NewtonsCradle",
        "ball-1",
    ),
    "acrylic-on-table": ("acrylic cube tossed on a table", "CubeToss", "cube"),
}
"""The two bodies of each pair in words; then the family of the task file, and the body in it.

The name begins with the material of the body.
"""


def material_pairs() -> tuple[MaterialPair, ...]:
    """Return all pairs."""
    return tuple(map(find_material, PAIRS))


def find_material(name: str, *, also: Iterable[str] = ()) -> MaterialPair:
    """Return a pair of materials.

    A pair `-recorded` has the restitution of recorded trials, which is the set `effective` of the task file.

    Args:
        name: Name of the pair.
        also: Further names that a message about an unknown one offers.

    Raises:
        UnknownNameError: There is no such pair.
    """
    if name not in PAIRS:
        raise UnknownNameError("material", name, [*PAIRS, *also])
    material = name.partition("-")[0]
    what, family, body = PAIRS[name]
    spec = task_spec(family)
    constants = spec.constants_of(body, material, None)
    friction, restitution = constants["friction"], constants["restitution"]
    mass_kg = constants["mass_kg"]
    assert restitution is not None and mass_kg is not None, "task files state both"
    source = spec.provenance_of(f"constants.{body}.{material}")
    friction_std = restitution_std = None
    sources = []
    if family == "NewtonsCradle":
        friction = None
    elif friction is not None and family != "CubeToss":
        friction_std = uncertainties.friction_std(friction, material)
        sources.append(f"friction: {uncertainties.FRICTION_SOURCE}")
    if name.endswith("-recorded"):
        restitution = spec.parameters["effective"].values[f"{body}.restitution"]
        source += f"; restitution: {spec.provenance_of('parameters.effective')}"
    elif family == "BouncingBall":
        # Only the ball's published restitution was compared with trials.
        restitution_std = uncertainties.RESTITUTION_SHARE * restitution
        sources.append(f"restitution: {uncertainties.RESTITUTION_SOURCE}")
    publications = filter(None, (spec.source.metadata, spec.source.paper))
    return MaterialPair(
        name=name,
        what=what,
        friction=friction,
        friction_std=friction_std,
        restitution=restitution,
        restitution_std=restitution_std,
        mass_kg=mass_kg,
        source=f"{source} ({', '.join(publications)})",
        uncertainty_sources=tuple(sources),
    )


def published_pairs() -> list[dict[str, str]]:
    """Return friction of further pairs as tables in the literature state it: texts, of which some are ranges."""
    text = read_content(scoring_folder("facts") / "friction_tables.csv").decode()
    return [
        {key: value or "-" for key, value in row.items()}
        for row in csv.DictReader(text.splitlines())
    ]
