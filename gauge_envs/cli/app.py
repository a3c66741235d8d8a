"""The `gauge` command: its commands are imported when one of them runs, and errors end it with an exit code."""

from __future__ import annotations

import errno
import re
from inspect import cleandoc
from typing import Annotated, Any

import typer
import typer.core

from gauge_envs.cli.arguments import check_spelling
from gauge_envs.cli.interrupts import (
    EXIT_INTERRUPTED,
    command_runs,
    handle_interrupts,
    report_interrupt,
    was_interrupted,
)
from gauge_envs.cli.output import EXIT_USAGE, echo, message
from gauge_envs.cli.streams import open_closed_streams, reserved_stdout
from gauge_envs.errors import GaugeError, ParameterError, UnknownNameError
from gauge_envs.registry import command_lines, instruments_by

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of a full or broken disk."""


def load_command(name: str) -> Any:
    """Return a command, imported from its instrument, or a group."""
    instrument = instruments_by("commands").get(name)
    if instrument is None:
        return _Group(name=name, help=command_lines()[name], no_args_is_help=True)
    function = instrument.function(name)
    # Rich would keep the ends of lines within a paragraph.
    text = re.sub(r"(?<!\n)\n(?!\n)", " ", cleandoc(function.__doc__ or ""))
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    below = [f"gauge {other}: {command_lines()[other]}" for other in _below(name)]
    epilog = "\n\n".join(["See also", *below]) if below else None
    single.command(name, cls=_Command, help=text, epilog=epilog)(function)
    return typer.main.get_command(single)


def _below(name: str) -> list[str]:
    """Return the names of the commands that are listed under a name; empty for the command line itself."""
    return [other for other in command_lines() if other.rpartition(" ")[0] == name]


class _Command(typer.core.TyperCommand):
    """Command whose function returns whether it failed, or its exit code.

    Its stdout holds its results only, whatever engines print.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        known = {
            option for one in self.params for option in (*one.opts, *one.secondary_opts)
        }
        if "--format" in known and "--json" in args:
            if any(word.startswith("--format") for word in args):
                raise ParameterError("--json is --format json: give one of them")
            args = ["--format=json" if word == "--json" else word for word in args]
        for option in (word.partition("=")[0] for word in args):
            if len(option) > 2 and option.startswith("--") and option not in known:
                check_spelling(
                    str(self.name),
                    option,
                    re.findall(r"\b([a-z]\w*)=", self.help or ""),
                )
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with reserved_stdout():
            try:
                has_failed = super().invoke(ctx)
            except SystemExit as error:
                message(
                    f"an engine or a library ended the command: SystemExit: {error}",
                    "error",
                )
                has_failed = True
        if has_failed:
            # True is a failure, and a number is the exit code itself.
            raise typer.Exit(int(has_failed))


class _Named(typer.core.TyperCommand):
    """Name and line of a command, which is imported when it gets its arguments."""

    def make_context(
        self, info_name: Any, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        return load_command(str(info_name)).make_context(
            info_name, args, parent=parent, **extra
        )


class _Group(typer.core.TyperGroup):
    """Commands by their names; the name of one may have two words, as `sanity probe` beside `sanity TARGET`."""

    def list_commands(self, ctx: Any) -> list[str]:
        name = self.name if self.name in command_lines() else ""
        return [other.removeprefix(f"{name} ") for other in _below(name)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        full = self._full(cmd_name)
        return (
            _Named(name=cmd_name, help=command_lines()[full])
            if full in command_lines()
            else None
        )

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        for count in (2, 1):
            name = self._full(" ".join(args[:count]))
            if name in command_lines():
                return name, self.get_command(ctx, " ".join(args[:count])), args[count:]
        raise UnknownNameError(
            "command", name, map(self._full, self.list_commands(ctx))
        )

    def _full(self, name: str) -> str:
        return f"{self.name} {name}" if self.name in command_lines() else name


class _Root(_Group):
    """The command line, which prints errors of gauge-envs without a traceback; no other place catches them."""

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
        message(str(error), "error")
    elif isinstance(error, OSError) and error.errno in UNWRITABLE:
        message(f"the output cannot be written: {error.strerror}", "error")
    else:
        raise error
    return EXIT_USAGE


app = typer.Typer(
    cls=_Root,
    name="gauge",
    epilog="Exit codes: 0 done; 1 done, with a failure that the help of the command describes; 2 the request cannot be "
    "met; 3 done, and not all could be measured; 130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(is_asked: bool) -> None:
    if is_asked:
        from importlib.metadata import version

        echo(f"gauge-envs {version('gauge-envs')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Show the version and exit.",
        ),
    ] = False,
) -> None:
    """Measure how far a physics engine is from real motion-capture trials (GAUGE benchmark)."""


def main() -> None:
    """Run the `gauge` command in this process."""
    handle_interrupts()
    open_closed_streams()
    app()
