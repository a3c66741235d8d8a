"""Measured pairs of materials: friction and restitution with source and uncertainty.

The numbers come from the task files; materials.csv names the place of each pair.
"""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from gauge_envs.errors import UnknownNameError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.references import uncertainties


@dataclass(frozen=True, kw_only=True)
class MaterialPair:
    """Measured contact of two materials.

    Attributes:
        name: Name, for example `wood-on-wood`.
        what: The two bodies.
        friction: Coefficient of friction; None if it was not measured.
        friction_std: Standard uncertainty of `friction`; None if it is not published.
        restitution: Coefficient of restitution.
        restitution_std: Standard uncertainty of `restitution`; None if it is not published.
        mass_kg: Mass of the real body [kg].
        source: Source of the numbers.
        uncertainty_sources: Source of each uncertainty.
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


@cache
def _places() -> dict[str, dict[str, str]]:
    """Return the two bodies of each pair in words, the family of its task file, and its body, by name.

    The name of a pair begins with the material of the body.
    """
    text = Path(__file__).with_name("materials.csv").read_text()
    return {row["name"]: row for row in csv.DictReader(text.splitlines())}


def material_pairs() -> tuple[MaterialPair, ...]:
    """Return all pairs."""
    return tuple(map(find_material, _places()))


def find_material(name: str, *, also: Iterable[str] = ()) -> MaterialPair:
    """Return a pair of materials.

    A pair `-recorded` has the restitution of recorded trials, the set `measured` of the task file.

    Args:
        name: Name of the pair.
        also: Extra names for the message about an unknown name.

    Raises:
        UnknownNameError: The pair does not exist.
    """
    places = _places()
    if name not in places:
        raise UnknownNameError("material", name, [*places, *also])
    material, place = name.partition("-")[0], places[name]
    spec, body = task_spec(place["family"]), place["body"]
    constants = spec.constants_of(body, material, None)
    friction = constants["friction"] if place["friction"] else None
    restitution, mass_kg = constants["restitution"], constants["mass_kg"]
    assert restitution is not None and mass_kg is not None, "task files have both"
    source = spec.provenance_of(f"constants.{body}.{material}")
    if set_name := place["restitution_set"]:
        restitution = spec.parameters[set_name].values[f"{body}.restitution"]
        source += f"; restitution: {spec.provenance_of(f'parameters.{set_name}')}"
    friction_std = restitution_std = None
    sources = []
    if friction is not None and place["friction_std"]:
        friction_std = uncertainties.friction_std(friction, material)
        sources.append(f"friction: {uncertainties.FRICTION_SOURCE}")
    if place["restitution_std"]:
        # Only the published restitution of the ball is compared with trials.
        restitution_std = uncertainties.RESTITUTION_SHARE * restitution
        sources.append(f"restitution: {uncertainties.RESTITUTION_SOURCE}")
    publications = filter(None, (spec.source.metadata, spec.source.paper))
    return MaterialPair(
        name=name,
        what=place["what"],
        friction=friction,
        friction_std=friction_std,
        restitution=restitution,
        restitution_std=restitution_std,
        mass_kg=mass_kg,
        source=f"{source} ({', '.join(publications)})",
        uncertainty_sources=tuple(sources),
    )
