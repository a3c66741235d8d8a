"""Read the calibrated fabrics of the benchmark from a task file."""

from __future__ import annotations

from dataclasses import fields

from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.task_format import ClothConstants
from gauge_envs.scene.fabrics import Fabric

FABRICS_FROM = "TextileFlinging"
"""Family whose task file names the six calibrated fabrics; other families repeat its constants."""


def fabrics(family: str = FABRICS_FROM) -> dict[str, Fabric]:
    """Return the calibrated fabrics of a family, by name.

    The default family has the six fabrics of the benchmark. The nylon of `TableclothPulling` is another cloth.
    """
    spec = task_spec(family)
    return {
        material: _fabric(ClothConstants.model_validate(spec.constants_of(cloth, material, None)))
        for cloth in spec.cloths
        for material in spec.constants[cloth]
    }


def _fabric(constants: ClothConstants) -> Fabric:
    return Fabric(**{field.name: getattr(constants, field.name) for field in fields(Fabric)})
