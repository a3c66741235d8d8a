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


CUBES = {
    f"{material}-on-wood{suffix}": (
        f"{material} cube on a {support}",
        family,
        "cube",
        material,
    )
    for suffix, support, family in (
        ("", "tilted wooden board", "SlopeSlider"),
        ("-plate", "turning wooden plate", "Turntable"),
    )
    for material in ("wood", "plastic", "metal")
}
DROP = ("BouncingBall", "ball", "rubber")
CRADLE = ("NewtonsCradle", "ball-1", "metal")
PLACES = CUBES | {
    "wood-on-wood-block": (
        "wooden tetrahedron on the seam of a wooden block",
        "SlopeContact",
        "teh",
        "wood",
    ),
    "plastic-on-plastic-block": (
        "plastic tetrahedron on the seam of a plastic block",
        "SlopeContact",
        "teh",
        "plastic",
    ),
    "rubber-on-wood": ("rubber ball on a wooden plank", *DROP),
    "rubber-on-wood-recorded": (
        "rubber ball on a wooden plank, restitution of the recorded drops",
        *DROP,
    ),
    "metal-on-metal": ("balls of a cradle", *CRADLE),
    "metal-on-metal-recorded": (
        "balls of a cradle, restitution that transfers the recorded momentum",
        *CRADLE,
    ),
    "acrylic-on-table": (
        "acrylic cube tossed on a table",
        "CubeToss",
        "cube",
        "acrylic",
    ),
}
"""The two bodies of each pair in words; then the family of the task file, and the body and material in it."""

RECORDED = ("rubber-on-wood-recorded", "metal-on-metal-recorded")
"""Pairs whose restitution is that of recorded trials, set `effective` of the task file."""

WITHOUT_FRICTION = ("metal-on-metal", "metal-on-metal-recorded")
"""Pairs whose friction was not measured."""

NOT_CALIBRATED = ("acrylic-on-table",)
"""Pairs whose friction does not have the uncertainty of the benchmark's calibration."""


def material_pairs() -> tuple[MaterialPair, ...]:
    """Return all pairs."""
    return tuple(map(find_material, PLACES))


def find_material(name: str, *, also: Iterable[str] = ()) -> MaterialPair:
    """Return a pair of materials.

    Args:
        name: Name of the pair.
        also: Further names that a message about an unknown one offers.
    """
    if name not in PLACES:
        raise UnknownNameError("material", name, [*PLACES, *also])
    what, family, body, material = PLACES[name]
    spec = task_spec(family)
    constants = spec.constants_of(body, material, None)
    friction, restitution, mass_kg = (
        constants[key] for key in ("friction", "restitution", "mass_kg")
    )
    assert restitution is not None and mass_kg is not None, "task files state both"
    origin = spec.provenance_of(f"constants.{body}.{material}")
    # Only the ball's published restitution was compared with trials.
    std = (
        uncertainties.RESTITUTION_SHARE * restitution
        if family == DROP[0] and name not in RECORDED
        else None
    )
    if name in RECORDED:
        restitution = spec.parameters["effective"].values[f"{body}.restitution"]
        origin += f"; restitution: {spec.provenance_of('parameters.effective')}"
    if name in WITHOUT_FRICTION:
        friction = None
    friction_std = None
    if friction is not None and name not in NOT_CALIBRATED:
        friction_std = uncertainties.friction_std(friction, material)
    whence = []
    if friction_std is not None:
        whence.append(f"friction: {uncertainties.FRICTION_SOURCE}")
    if std is not None:
        whence.append(f"restitution: {uncertainties.RESTITUTION_SOURCE}")
    return MaterialPair(
        name=name,
        what=what,
        friction=friction,
        friction_std=friction_std,
        restitution=restitution,
        restitution_std=std,
        mass_kg=mass_kg,
        source=f"{origin} ({', '.join(filter(None, (spec.source.metadata, spec.source.paper)))})",
        uncertainty_sources=tuple(whence),
    )


def published_pairs() -> list[dict[str, str]]:
    """Return friction of further pairs as tables in the literature state it: texts, of which some are ranges."""
    text = read_content(scoring_folder("facts") / "friction_tables.csv").decode()
    return [
        {key: value or "-" for key, value in row.items()}
        for row in csv.DictReader(text.splitlines())
    ]
