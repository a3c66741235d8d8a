"""Write the task file of an experiment with a tested fabric."""

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.task_files import fabrics, task_spec
from gauge_envs.experiments.variants import Variant, task_path
from gauge_envs.scene.fabrics import Fabric

TESTED = "tested"
"""Material of a tested fabric."""


def task_of_fabric(variant: Variant, fabric: Fabric, file: Path) -> str:
    """Return the task file of an experiment with another fabric, whose friction and restitution stay.

    Args:
        variant: The experiment.
        fabric: The fabric.
        file: Path of the new file, whose name is part of the family.

    Raises:
        ParameterError: The experiment has none of the published fabrics.
    """
    material = variant.material
    if material not in fabrics(variant.family):
        raise ParameterError(
            f"{variant.id} has no fabric as its material: give an experiment as StripBending-satin"
        )
    spec = task_spec(variant.family)
    document = tomllib.loads(task_path(variant.family).read_text(encoding="utf-8"))
    origins = document["provenance"]
    for name, cloth in spec.cloths.items():
        mass_kg = fabric.areal_density_kg_per_m2 * math.prod(cloth.size_m)
        published = document["constants"][name][material]
        tested = published | asdict(fabric) | {"mass_kg": mass_kg}
        document["constants"][name] = {TESTED: tested}
        origins[f"constants.{name}.{TESTED}"] = "derived: own tests"
        for constant in ("friction", "restitution"):
            origins[f"constants.{name}.{TESTED}.{constant}"] = f"nominal: of {material}"
    word = "".join(part.capitalize() for part in re.findall("[A-Za-z0-9]+", file.stem))
    document |= {
        "family": word + variant.family,
        "materials": [TESTED],
        "frames": {TESTED: spec.frame_count(variant)},
    }
    document.pop("metadata_materials", None)
    return "".join(f"{line}\n" for line in _lines(document))


def _lines(table: Mapping[str, Any], header: str = "") -> Iterator[str]:
    """Yield the lines of a table: its values, then the tables in it."""
    tables = {key: value for key, value in table.items() if isinstance(value, dict)}
    if header and len(tables) < len(table):
        yield f"\n[{header}]"
    for key, value in table.items():
        if key not in tables:
            yield f"{_key(key)} = {_value(value)}"
    for key, inner in tables.items():
        yield from _lines(inner, f"{header}.{_key(key)}".removeprefix("."))


def _key(key: str) -> str:
    """Return a key, in quotes if it has more than letters, digits, - and _."""
    return key if re.fullmatch("[A-Za-z0-9_-]+", key) else json.dumps(key)


def _value(value: Any) -> str:
    """Return a value on one line; numbers and texts of JSON are those of TOML."""
    if isinstance(value, dict):
        pairs = ", ".join(
            f"{_key(key)} = {_value(inner)}" for key, inner in value.items()
        )
        return f"{{ {pairs} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value)
