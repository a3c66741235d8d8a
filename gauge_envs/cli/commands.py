"""The commands of `gauge`: their functions, their help lines, and their output with `--json`.

Another package can add a command as an entry point of the group `gauge_envs.instruments`. Its name is the name of the
command, and its value is a function that typer can call:

    [project.entry-points."gauge_envs.instruments"]
    drift = "my_package.drift:drift"
"""

from dataclasses import dataclass
from functools import cache
from pkgutil import resolve_name
from typing import Any

from gauge_envs.optional import needs_extra
from gauge_envs.registry import PACKAGE, installed_points

PLUGINS_GROUP = "gauge_envs.instruments"


@dataclass(frozen=True)
class Command:
    """A command, or a kind of `gauge list`, as `list checks`.

    Attributes:
        name: Words of the command.
        place: Module and function, as `catalog.command:show`.
        help: Line in the help of `gauge`; a kind of `gauge list` has none.
        line: Module and type of a line of `--json`, as `catalog.schema:Show`; empty without `--json`.
        version: Version of the schema of the line.
        extra: Extra of this package that it needs, or empty.
        package: Package of the modules, with a dot at the end.
    """

    name: str
    place: str
    help: str = ""
    line: str = ""
    version: int = 1
    extra: str = ""
    package: str = "gauge_envs.tools."

    def function(self) -> Any:
        """Return the function, imported from its module.

        Raises:
            MissingExtraError: The extra is not installed; the function raises it too.
        """
        if not self.extra:
            return resolve_name(self.package + self.place)
        with needs_extra(f"gauge {self.name}", self.extra):
            function = resolve_name(self.package + self.place)
        return needs_extra(f"gauge {self.name}", self.extra)(function)

    def line_type(self) -> Any:
        """Return the type of a line of `--json`."""
        return resolve_name(self.package + self.line)


GROUPS = {
    "backend": "Check physics engines, and find what changed between two releases.",
    "data": "Real trials and scenes: download, import, write for other tools.",
    "video": "Judge videos of world models by the laws of motion.",
}
"""Help line of each first word that is not a command."""

BUNDLED = (
    Command(
        "list",
        "catalog.command:list_",
        "List experiments; or backends, checks, phenomena, materials, scenes, ...",
        line="catalog.schema:ListLine",
        version=5,
    ),
    Command(
        "show",
        "catalog.command:show",
        "Show one experiment or control task: reference, reward, spaces, engines, constants.",
        line="catalog.schema:Show",
        version=7,
    ),
    Command(
        "list schemas",
        "catalog.command:list_schemas",
        line="catalog.schema:SchemaLine",
    ),
    Command(
        "run",
        "run.command:run",
        "Run experiments, score each against its reference, and write a result file for each.",
        line="run.schema:RunLine",
        version=7,
    ),
    Command(
        "score",
        "run.command:score",
        "Score a trajectory from your own simulator; no engine is needed.",
        line="run.schema:RunLine",
        version=7,
    ),
    Command(
        "compare",
        "compare.compare_command:compare",
        "Compare engines, parameters and settings: scores with intervals, and ranks.",
        line="compare.schema:CompareLine",
        version=5,
    ),
    Command(
        "plot",
        "compare.plot_command:plot",
        "Draw results: experiments over real bands, or a comparison.",
    ),
    Command(
        "report",
        "site.command:report",
        "Write results as a static site: figures and tables of scores, and 3D views of the motions.",
    ),
    Command(
        "sweep",
        "sweep.command:sweep",
        "Run engines, settings and experiments in all combinations; continue an earlier run.",
        line="sweep.schema:SweepLine",
        version=7,
    ),
    Command(
        "sanity",
        "sanity.command:sanity",
        "Check the physics of a training configuration, and print the best fix of its settings.",
        line="sanity.schema:SanityLine",
        version=7,
    ),
    Command(
        "sanity probe",
        "sanity.command:sanity_probe",
        "Print a Python file that saves the settings of a training environment.",
    ),
    Command(
        "list phenomena",
        "sanity.command:list_checks",
        line="sanity.schema:CheckLine",
    ),
    Command(
        "replay",
        "replay.command:replay",
        "Name the cause that makes a robot, or another simulator, move unlike your model.",
        line="replay.schema:ReplayLine",
    ),
    Command(
        "recipe",
        "recipes.recipe_command:recipe",
        "Find contact settings of an engine for a measured behaviour, and measure what they reach.",
        line="recipes.schema:RecipeLine",
        version=3,
    ),
    Command(
        "recipe fabrics",
        "recipes.recipe_command:recipe_fabrics",
        "Show the six fabrics in the constants of every engine.",
        line="recipes.schema:FabricsLine",
    ),
    Command(
        "list materials",
        "recipes.recipe_command:list_materials",
        line="recipes.schema:MaterialLine",
        version=3,
    ),
    Command(
        "backend check",
        "conformance.command:backend_check",
        "Check engines against closed forms, with the most likely cause of each failure.",
        line="conformance.schema:CheckResultLine",
        version=5,
    ),
    Command(
        "list backends",
        "conformance.command:list_backends",
        line="conformance.schema:BackendLine",
    ),
    Command(
        "list checks",
        "conformance.command:list_checks",
        line="conformance.schema:CheckLine",
        version=2,
    ),
    Command(
        "backend versions",
        "versions.command:backend_versions",
        "Compare releases of MuJoCo on your model, settings or engines: what changed, and which side is right.",
        line="versions.schema:VersionsLine",
        version=5,
    ),
    Command(
        "data download",
        "dataset.commands:data_download",
        "Download the GAUGE dataset (10 GB in all); an interrupted download resumes.",
    ),
    Command(
        "data import",
        "dataset.commands:data_import",
        "Import real trials as bands and prescribed motions, and compare them with published baselines; offline.",
        line="dataset.schema:ImportLine",
    ),
    Command(
        "list references",
        "dataset.commands:list_references",
        line="dataset.schema:StatusLine",
        version=3,
    ),
    Command(
        "data scenes",
        "assets.commands:data_scenes",
        "Write every scene as USD and MJCF, and every solid as OBJ.",
        extra="usd",
    ),
    Command(
        "data isaac-sim",
        "assets.commands:data_isaac_sim",
        "Write experiments as USD layers that Isaac Sim simulates.",
        extra="usd",
    ),
    Command(
        "list scenes",
        "assets.commands:list_scenes",
        line="assets.commands:SceneLine",
        version=2,
        extra="usd",
    ),
    Command(
        "video prompts",
        "video.commands:video_prompts",
        "Fetch the first frame and the prompt of each task of the benchmark (3 MB).",
        extra="video",
    ),
    Command(
        "video score",
        "video.commands:video_score",
        "Follow the object in videos, fit the law of the task, and report its metrics.",
        line="video.schema:VideoLine",
        version=5,
        extra="video",
    ),
    Command(
        "video report",
        "video.commands:video_report",
        "Score the videos of many models, and write a page with a table and pictures.",
        extra="video",
    ),
    Command(
        "list video-tasks",
        "video.commands:list_video_tasks",
        line="video.schema:TaskLine",
        extra="video",
    ),
)
"""Commands of this package in the order of the help; a command without its folder is omitted."""


@cache
def all_commands() -> dict[str, Command]:
    """Return commands and kinds of `gauge list` by name; plug-ins cannot replace a bundled name."""
    plugins = (
        Command(point.name, point.value, f"Of the package {point.module}.", package="")
        for point in installed_points(PLUGINS_GROUP)
    )
    by_name: dict[str, Command] = {}
    for command in (*BUNDLED, *plugins):
        folder = PACKAGE / "tools" / command.place.partition(".")[0]
        if not command.package or folder.is_dir():
            by_name.setdefault(command.name, command)
    return by_name


def commands() -> dict[str, Command]:
    """Return the commands by name, in the order of the help."""
    return {name: command for name, command in all_commands().items() if command.help}


def listings() -> dict[str, Command]:
    """Return the kinds of `gauge list` besides experiments, by name, as `checks`."""
    return {
        name.removeprefix("list "): command
        for name, command in all_commands().items()
        if not command.help
    }


def help_lines() -> dict[str, str]:
    """Return the help line of each command and group, in the order of the help."""
    lines: dict[str, str] = {}
    for name, command in commands().items():
        group = name.partition(" ")[0]
        if group in GROUPS:
            lines.setdefault(group, GROUPS[group])
        lines[name] = command.help
    return lines
