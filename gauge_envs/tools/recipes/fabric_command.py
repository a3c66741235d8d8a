"""`gauge materials`."""

from __future__ import annotations

from gauge_envs.cli.arguments import Json, Wide
from gauge_envs.cli.output import print_document


def materials(json_lines: Json = False, wide: Wide = False) -> None:
    """Show the six fabrics in every engine's constants, the stiffness that these give, and what is lost."""
    from gauge_envs.experiments.fabrics import fabrics
    from gauge_envs.tools.recipes.words import constants_document

    print_document(constants_document(fabrics()), json_lines=json_lines, wide=wide)
