"""The `gauge` command: the names of the commands, which are imported when one of them runs, and its exit codes."""

from __future__ import annotations

import errno
from importlib import import_module
from typing import Any

import typer
import typer.core

from gauge_envs.cli.interrupts import (
    EXIT_INTERRUPTED,
    command_runs,
    handle_interrupts,
    report_interrupt,
    was_interrupted,
)
from gauge_envs.cli.output import EXIT_FAILED, EXIT_USAGE, plain_text, stderr_console
from gauge_envs.cli.streams import open_closed_streams, reserved_stdout
from gauge_envs.errors import GaugeError

COMMANDS = {
    "list": "catalog.command:list_",
    "show": "catalog.command:show",
    "run": "run.command:run",
    "score": "run.command:score",
    "plot": "compare.command:plot",
    "compare": "compare.command:compare",
    "diagnose": "diagnose.command:diagnose",
    "report": "site.command:report",
    "sanity": "sanity.command:sanity",
    "materials": "recipes.fabric_command:materials",
    "sweep": "sweep.command:sweep",
    "film": "film.command:film",
    "recipe": "recipes.command:recipe",
    "transfer": "transfer.command:transfer",
    "envelope": "transfer.command:envelope",
    "sanity probe": "sanity.probe_command:sanity_probe",
    "sanity export": "sanity.export_command:sanity_export",
    "sanity judge": "sanity.export_command:sanity_judge",
    "backend": "conformance.command:backend_app",
    "assets": "assets.command:assets_app",
    "data": "dataset.command:data_app",
    "video": "video.command:video_app",
    "leaderboard": "leaderboard.command:leaderboard_app",
    "export": "film.rerun_command:export_app",
}
"""Functions and groups of the instruments in `gauge_envs.tools`, as `module:name`."""

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of a full or broken disk."""


def _print_error(text: str) -> None:
    stderr_console().print(f"[red]error:[/] {plain_text(text)}", soft_wrap=True)


class _Command(typer.core.TyperCommand):
    """Command whose stdout holds its results only, whatever engines print, and which no engine can end."""

    def invoke(self, ctx: Any) -> Any:
        with reserved_stdout():
            try:
                return super().invoke(ctx)
            except SystemExit as error:
                _print_error(f"an engine or a library ended the command: SystemExit: {error}")
                raise typer.Exit(EXIT_FAILED) from None


def _loaded(name: str) -> Any:
    """Return the command or the group of a name, imported from its instrument."""
    module, _, attribute = COMMANDS[name].partition(":")
    found = getattr(import_module(f"gauge_envs.tools.{module}"), attribute)
    if isinstance(found, typer.Typer):
        for registered in found.registered_commands:
            registered.cls = _Command
        group = typer.main.get_command(found)
        group.name = name
        return group
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    single.command(name, cls=_Command)(found)
    return typer.main.get_command(single)


class _Group(typer.core.TyperGroup):
    """Group that prints errors of gauge-envs without a traceback; no other place catches them.

    The name of a command may have two words, as `sanity probe` beside `sanity TARGET`.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return _loaded(cmd_name) if cmd_name in COMMANDS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        words = " ".join(args[:2])
        return super().resolve_command(ctx, [words, *args[2:]] if words in COMMANDS else args)

    def invoke(self, ctx: Any) -> Any:
        try:
            with command_runs():
                return super().invoke(ctx)
        except typer.Exit:
            raise
        except BaseException as error:
            raise typer.Exit(_exit_code(error)) from None


def _exit_code(error: BaseException) -> int:
    """Print the message of an error that ends the command, and return its exit code; raise any other error."""
    # A library may turn Ctrl-C into an error of its own.
    if isinstance(error, KeyboardInterrupt) or was_interrupted():
        report_interrupt()
        return EXIT_INTERRUPTED
    if isinstance(error, GaugeError):
        _print_error(str(error))
    elif isinstance(error, OSError) and error.errno in UNWRITABLE:
        _print_error(f"the output cannot be written: {error.strerror}")
    else:
        raise error
    return EXIT_USAGE


app = typer.Typer(
    cls=_Group,
    name="gauge",
    help="Measure how far a physics engine is from real motion-capture trials (GAUGE benchmark).",
    epilog="Exit codes: 0 done; 1 done, with a failure that the help of the command describes; 2 the request cannot be "
    "met; 130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _root() -> None:
    """Measure how far a physics engine is from real motion-capture trials (GAUGE benchmark)."""


def main() -> None:
    """Run the `gauge` command in this process."""
    handle_interrupts()
    open_closed_streams()
    app()
