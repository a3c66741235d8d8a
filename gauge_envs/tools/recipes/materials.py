"""Pairs of materials whose friction and restitution were measured, with source and uncertainty.

All numbers are those of the task files; none stands here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gauge_envs.errors import UnknownNameError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.references.sensitivities import input_uncertainties


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
        uncertainty_source: Where the uncertainties come from; empty if there is none.
    """

    name: str
    what: str
    friction: float | None
    friction_std: float | None
    restitution: float
    restitution_std: float | None
    mass_kg: float
    source: str
    uncertainty_source: str


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Where the numbers of a pair stand.

    Attributes:
        what: The two bodies.
        family: Family of the task file.
        body: Body whose constants are those of the pair.
        material: Material of the body.
        recorded: Whether the restitution is that of recorded trials, set `effective` of the task file.
        has_friction: Whether the friction was measured.
        is_calibrated: Whether the friction has the uncertainty of the benchmark's calibration.
    """

    what: str
    family: str
    body: str
    material: str
    recorded: bool = False
    has_friction: bool = True
    is_calibrated: bool = True


PLACES = {
    **{
        f"{material}-on-wood": _Place(
            what=f"{material} cube on a tilted wooden board", family="SlopeSlider", body="cube", material=material
        )
        for material in ("wood", "plastic", "metal")
    },
    **{
        f"{material}-on-wood-plate": _Place(
            what=f"{material} cube on a turning wooden plate", family="Turntable", body="cube", material=material
        )
        for material in ("wood", "plastic", "metal")
    },
    "wood-on-wood-block": _Place(
        what="wooden tetrahedron on the seam of a wooden block", family="SlopeContact", body="teh", material="wood"
    ),
    "plastic-on-plastic-block": _Place(
        what="plastic tetrahedron on the seam of a plastic block", family="SlopeContact", body="teh", material="plastic"
    ),
    "rubber-on-wood": _Place(
        what="rubber ball on a wooden plank", family="BouncingBall", body="ball", material="rubber"
    ),
    "rubber-on-wood-recorded": _Place(
        what="rubber ball on a wooden plank, restitution of the recorded drops",
        family="BouncingBall",
        body="ball",
        material="rubber",
        recorded=True,
    ),
    "metal-on-metal": _Place(
        what="balls of a cradle", family="NewtonsCradle", body="ball-1", material="metal", has_friction=False
    ),
    "metal-on-metal-recorded": _Place(
        what="balls of a cradle, restitution that transfers the recorded momentum",
        family="NewtonsCradle",
        body="ball-1",
        material="metal",
        recorded=True,
        has_friction=False,
    ),
    "acrylic-on-table": _Place(
        what="acrylic cube tossed on a table", family="CubeToss", body="cube", material="acrylic", is_calibrated=False
    ),
}


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
    place = PLACES[name]
    spec = task_spec(place.family)
    constants = spec.constants_of(place.body, place.material, None)
    uncertain = input_uncertainties()
    restitution = constants["restitution"]
    origin = spec.provenance_of(f"constants.{place.body}.{place.material}")
    std = None
    if place.recorded:
        restitution = spec.parameters["effective"].values[f"{place.body}.restitution"]
        origin += f"; restitution: {spec.provenance_of('parameters.effective')}"
        # Only the drops of the ball were measured more than once.
        std = uncertain.restitution.std if place.family == "BouncingBall" else None
    mass_kg = constants["mass_kg"]
    assert restitution is not None and mass_kg is not None, "task files state both"
    friction_std = uncertain.friction.std if place.has_friction and place.is_calibrated else None
    whence = [f"friction: {uncertain.friction.source}" if friction_std is not None else ""]
    whence.append(f"restitution: {uncertain.restitution.source}" if std is not None else "")
    files = ", ".join(filter(None, (spec.source.metadata, spec.source.paper)))
    return MaterialPair(
        name=name,
        what=place.what,
        friction=constants["friction"] if place.has_friction else None,
        friction_std=friction_std,
        restitution=restitution,
        restitution_std=std,
        mass_kg=mass_kg,
        source=f"{origin} ({files})",
        uncertainty_source="; ".join(filter(None, whence)),
    )
