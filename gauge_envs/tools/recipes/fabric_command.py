"""`gauge materials`."""

from __future__ import annotations

from gauge_envs.cli.arguments import Json, Wide
from gauge_envs.cli.output import (
    print_json_lines,
    stdout_console,
)


def materials(json_lines: Json = False, wide: Wide = False) -> None:
    """Show the six fabrics in every engine's constants, the stiffness that these give, and what is lost."""
    from gauge_envs.experiments.task_files import fabrics
    from gauge_envs.tools.recipes.fabric_words import material_values, material_view

    if json_lines:
        print_json_lines([material_values(fabrics())])
    else:
        stdout_console().print(material_view(fabrics(), wide=wide))
