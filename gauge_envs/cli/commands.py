"""The commands of `gauge`: their functions, their help lines, and their output with `--json`.

A command is an entry point of the group `gauge_envs.commands`. Its name is the name of the command, and its value is a
function that typer can call. The type of a line of `--json` is an entry point of `gauge_envs.lines` with the same name.
Another package can add commands:

    [project.entry-points."gauge_envs.commands"]
    drift = "my_package.drift:drift"
"""

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

from gauge_envs.optional import needs_extra
from gauge_envs.registry import BUNDLED, PACKAGE, installed_points

COMMANDS_GROUP = "gauge_envs.commands"
LINES_GROUP = "gauge_envs.lines"

GROUPS = {
    "backend": "Check physics engines, and find what changed between two releases.",
    "data": "Real trials and scenes: download, import, write for other tools.",
    "video": "Judge videos of world models by the laws of motion.",
}
"""Help line of each first word that is not a command."""


@dataclass(frozen=True)
class CommandInfo:
    """What is known of a command without importing it.

    Attributes:
        help: Line in the help of `gauge`; a kind of `gauge list` has none.
        version: Version of the schema of a line of `--json`.
        extra: Extra of this package that it needs, or empty.
    """

    help: str = ""
    version: int = 1
    extra: str = ""


BUNDLED_COMMANDS = {
    "demo": CommandInfo(
        "Measure a ball, constants, a robot's contacts and a policy, and show them on a page."
    ),
    "list": CommandInfo(
        "List experiments; or backends, checks, phenomena, materials, scenes, ...",
        version=5,
    ),
    "show": CommandInfo(
        "Show one experiment or control task: reference, reward, spaces, engines, constants.",
        version=7,
    ),
    "list schemas": CommandInfo(),
    "run": CommandInfo(
        "Run experiments, score each against its reference, and write a result file for each.",
        version=7,
    ),
    "score": CommandInfo(
        "Score a trajectory from your own simulator; no engine is needed.", version=7
    ),
    "reference": CommandInfo(
        "Solve a scene at refined steps, contacts and cells, and write the solution as its reference."
    ),
    "compare": CommandInfo(
        "Compare engines, parameters and settings: scores with intervals, and ranks.",
        version=5,
    ),
    "plot": CommandInfo("Draw results: experiments over real bands, or a comparison."),
    "report": CommandInfo(
        "Write results as a static site: figures and tables of scores, and 3D views of the motions."
    ),
    "sweep": CommandInfo(
        "Run engines, settings and experiments in all combinations; continue an earlier run.",
        version=7,
    ),
    "sanity": CommandInfo(
        "Check the physics of a robot model or an RL task, and name causes before effects.",
        version=7,
    ),
    "sanity probe": CommandInfo(
        "Print a Python file that saves the settings of a training environment."
    ),
    "list phenomena": CommandInfo(),
    "replay": CommandInfo(
        "Name the cause that makes a robot, or another simulator, move unlike your model."
    ),
    "recipe": CommandInfo(
        "Find contact settings of an engine for a measured behaviour, and measure what they reach.",
        version=3,
    ),
    "recipe fabrics": CommandInfo(
        "Show a tested fabric, or the six fabrics, in the constants of every engine."
    ),
    "list materials": CommandInfo(version=3),
    "backend check": CommandInfo(
        "Check engines against closed forms, with the most likely cause of each failure.",
        version=5,
    ),
    "list backends": CommandInfo(),
    "list checks": CommandInfo(version=2),
    "backend versions": CommandInfo(
        "Compare releases of MuJoCo on your model, settings or engines: what changed, and which side is right.",
        version=5,
    ),
    "data download": CommandInfo(
        "Download the GAUGE dataset (10 GB in all); an interrupted download resumes."
    ),
    "data import": CommandInfo(
        "Import real trials as bands and prescribed motions, and compare them with published baselines; offline."
    ),
    "list references": CommandInfo(version=4),
    "data scenes": CommandInfo(
        "Write every scene as USD and MJCF, and every solid as OBJ.", extra="usd"
    ),
    "data isaac-sim": CommandInfo(
        "Write experiments as USD layers that Isaac Sim simulates.", extra="usd"
    ),
    "list scenes": CommandInfo(version=2, extra="usd"),
    "video prompts": CommandInfo(
        "Fetch the first frame and the prompt of each task of the benchmark (3 MB).",
        extra="video",
    ),
    "video score": CommandInfo(
        "Follow the object in videos, fit the law of the task, and report its metrics.",
        version=5,
        extra="video",
    ),
    "video report": CommandInfo(
        "Score the videos of many models, and write a page with a table and pictures.",
        extra="video",
    ),
    "list video-tasks": CommandInfo(extra="video"),
}
"""Commands of this package and kinds of `gauge list`, as `list checks`, in the order of the help."""


@dataclass(frozen=True)
class Command:
    """A command, or a kind of `gauge list`.

    Attributes:
        point: Entry point of its function.
        info: What is known without importing it.
    """

    point: EntryPoint
    info: CommandInfo

    def function(self) -> Any:
        """Return the function, imported from its module.

        Raises:
            MissingExtraError: The extra is not installed; the function raises it too.
        """
        extra = self.info.extra
        if not extra:
            return self.point.load()
        feature = f"gauge {self.point.name}"
        with needs_extra(feature, extra):
            function = self.point.load()
        return needs_extra(feature, extra)(function)


def _has_folder(point: EntryPoint) -> bool:
    """Return whether the folder of a command of this package exists; a user may remove it."""
    return PACKAGE.joinpath(*point.module.split(".")[1:-1]).is_dir()


@cache
def all_commands() -> dict[str, Command]:
    """Return commands and kinds of `gauge list` by name; plug-ins cannot replace a bundled name."""
    own: dict[str, EntryPoint] = {}
    plugins: list[EntryPoint] = []
    for point in installed_points(COMMANDS_GROUP):
        if not point.value.startswith(BUNDLED):
            plugins.append(point)
        elif _has_folder(point):
            own[point.name] = point
    by_name = {
        name: Command(own[name], info)
        for name, info in BUNDLED_COMMANDS.items()
        if name in own
    }
    for point in plugins:
        info = CommandInfo(f"Of the package {point.module}.")
        by_name.setdefault(point.name, Command(point, info))
    return by_name


def commands() -> dict[str, Command]:
    """Return the commands by name, in the order of the help."""
    return {
        name: command for name, command in all_commands().items() if command.info.help
    }


def listings() -> dict[str, Command]:
    """Return the kinds of `gauge list` besides experiments, by name, as `checks`."""
    return {
        name.removeprefix("list "): command
        for name, command in all_commands().items()
        if not command.info.help
    }


def help_lines() -> dict[str, str]:
    """Return the help line of each command and group, in the order of the help."""
    lines: dict[str, str] = {}
    for name, command in commands().items():
        group = name.partition(" ")[0]
        if group in GROUPS:
            lines.setdefault(group, GROUPS[group])
        lines[name] = command.info.help
    return lines
