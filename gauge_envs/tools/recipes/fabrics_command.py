"""`gauge recipe fabrics` and `gauge list materials`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, print_document

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.scene.fabrics import Fabric


FABRICS_FAMILY = "TextileFlinging"
"""Family whose task file has the six calibrated fabrics of the benchmark; other families repeat its constants."""


def known_fabrics() -> Mapping[str, Fabric]:
    """Return the calibrated fabrics by name."""
    from gauge_envs.experiments.task_files import fabrics

    return fabrics(FABRICS_FAMILY)


def recipe_fabrics(form: arguments.Form = Format.TEXT) -> None:
    """Show the six fabrics in every engine's constants, and what is lost.

    Each has the stiffness that its constants give.
    """
    from gauge_envs.tools.recipes.words import constants_document

    print_document(constants_document(known_fabrics()), form)


def list_materials(patterns: Sequence[str]) -> list[Table]:
    """Return the tables of the measured pairs and fabrics."""
    from gauge_envs.tools.recipes.materials import material_pairs, published_pairs
    from gauge_envs.tools.recipes.words import (
        fabric_table,
        material_table,
        published_table,
    )

    tables = [
        material_table(material_pairs()),
        published_table(published_pairs()),
        fabric_table(known_fabrics()),
    ]
    return arguments.matching(tables, patterns, kind="material")
