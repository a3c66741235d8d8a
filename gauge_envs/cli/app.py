"""The `gauge` command. Heavy imports are inside the commands, so that help and completion stay quick."""

from __future__ import annotations

import errno
from typing import Any

import typer
import typer.core

from gauge_envs.cli.checks import backend_app, sanity
from gauge_envs.cli.control import envelope, transfer
from gauge_envs.cli.data import assets_app, data_app
from gauge_envs.cli.describe import list_, materials, show
from gauge_envs.cli.export import export_app
from gauge_envs.cli.film import film
from gauge_envs.cli.interrupts import (
    EXIT_INTERRUPTED,
    command_runs,
    handle_interrupts,
    report_interrupt,
    was_interrupted,
)
from gauge_envs.cli.leaderboard import leaderboard_app
from gauge_envs.cli.output import EXIT_FAILED, EXIT_USAGE, plain_text, stderr_console
from gauge_envs.cli.recipe import recipe
from gauge_envs.cli.report import report
from gauge_envs.cli.results import compare, diagnose, plot
from gauge_envs.cli.run import run, score
from gauge_envs.cli.sanity_export import sanity_export, sanity_judge
from gauge_envs.cli.sanity_probe import sanity_probe
from gauge_envs.cli.streams import open_closed_streams, reserved_stdout
from gauge_envs.cli.sweep import query, sweep
from gauge_envs.cli.video import video_app
from gauge_envs.errors import GaugeError

__all__ = ["app", "main"]

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


class _Group(typer.core.TyperGroup):
    """Group that prints errors of gauge-envs without a traceback; no other place catches them.

    The name of a command may have two words, as `sanity probe` beside `sanity TARGET`.
    """

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        words = " ".join(args[:2])
        return super().resolve_command(ctx, [words, *args[2:]] if words in self.commands else args)

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
app.command("list")(list_)
for command in (show, run, score, plot, compare, diagnose, report, sanity, materials):
    app.command()(command)
app.command()(sweep)
app.command()(query)
app.command()(film)
app.command()(recipe)
app.command()(transfer)
app.command()(envelope)
app.command("sanity probe")(sanity_probe)
app.command("sanity export")(sanity_export)
app.command("sanity judge")(sanity_judge)
app.add_typer(backend_app, name="backend")
app.add_typer(assets_app, name="assets")
app.add_typer(data_app, name="data")
app.add_typer(video_app, name="video")
app.add_typer(leaderboard_app, name="leaderboard")
app.add_typer(export_app, name="export")
for group in (app, backend_app, assets_app, data_app, video_app, leaderboard_app, export_app):
    for registered in group.registered_commands:
        registered.cls = _Command


def main() -> None:
    """Run the `gauge` command in this process."""
    handle_interrupts()
    open_closed_streams()
    app()
