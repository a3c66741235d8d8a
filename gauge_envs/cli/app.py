"""The `gauge` command: its commands are imported when one of them runs, and errors end it with an exit code."""

from __future__ import annotations

import errno
import functools
import inspect
import os
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from gauge_envs.cli import arguments
from gauge_envs.cli.commands import commands, help_lines
from gauge_envs.cli.interrupts import (
    EXIT_INTERRUPTED,
    command_runs,
    handle_interrupts,
    report_interrupt,
    was_interrupted,
)
from gauge_envs.cli.output import EXIT_USAGE, echo, message, quieted
from gauge_envs.cli.streams import open_closed_streams, reserved_stdout
from gauge_envs.cli.values import checked_values
from gauge_envs.errors import GaugeError, ParameterError, UnknownNameError

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of a full or broken disk."""


def load_command(name: str) -> Any:
    """Return a command, imported from its module, or a group."""
    found = commands().get(name)
    if found is None:
        return _Group(name=name, help=help_lines()[name], no_args_is_help=True)
    function = found.function()
    # Rich would keep the ends of lines within a paragraph.
    text = re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(function.__doc__ or ""))
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    below = [f"gauge {other}: {help_lines()[other]}" for other in _below(name)]
    epilog = "\n\n".join(["See also", *below]) if below else None
    command = _with_common_options(function)
    single.command(name, cls=_Command, help=text, epilog=epilog)(command)
    return typer.main.get_command(single)


JsonFlag = Annotated[
    bool,
    arguments.option(arguments.OUTPUT, "Short for --format json.", "--json"),
]

QuietFlag = Annotated[
    bool,
    arguments.option(
        arguments.OUTPUT,
        "No progress, notes and totals on stderr; errors stay.",
        "--quiet",
        "-q",
    ),
]


def _with_common_options(function: Any) -> Any:
    """Return a command with the options that every command has, and `--json` beside `--format`."""
    signature = inspect.signature(function, eval_str=True)
    common = {"quiet": QuietFlag} | (
        {"json": JsonFlag} if "form" in signature.parameters else {}
    )

    @functools.wraps(function)
    def command(**values: Any) -> Any:
        # The parser has turned --json into --format json.
        values.pop("json", None)
        with quieted(values.pop("quiet")):
            return function(**values)

    parameters = [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=annotation
        )
        for name, annotation in common.items()
    ]
    command.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*signature.parameters.values(), *parameters]
    )
    return command


def _below(name: str) -> list[str]:
    """Return the names of the commands that are listed under a name; empty for the command line itself."""
    return [other for other in help_lines() if other.rpartition(" ")[0] == name]


TYPE_WORDS = {"<int range>": "integer", "<int>": "integer", "<float>": "number"}
"""What the help shows for types of Python."""


def _shown_type(parameter: Any, ctx: Any) -> str | None:
    """Return the type of a parameter for the help; None for a flag, and for an argument, whose name says it."""
    if parameter.param_type_name == "argument" or parameter.is_flag:
        return None
    if parameter.metavar is not None:
        return str(parameter.metavar)
    shown = str(parameter.display_type(ctx))
    return TYPE_WORDS.get(shown, shown)


def _name_types(command: Any, ctx: Any) -> None:
    """Let the help of a command show the types that `_shown_type` returns; versions of typer below 0.26 show theirs.

    Defaults in words end the line of help, as `[default: all]`, where typer writes `[default: (all)]`.
    """
    for one in command.get_params(ctx):
        one.display_type_rich = functools.partial(_shown_type, one)
        shown = getattr(one, "show_default", None)
        if isinstance(shown, str):
            one.help = rf"{one.help} [dim]\[default: {shown}][/dim]"
            one.show_default = False


class _Command(typer.core.TyperCommand):
    """Command whose function returns whether it failed, or its exit code.

    Its stdout holds its results only, whatever engines print.
    """

    def format_help(self, ctx: Any, formatter: Any) -> None:
        _name_types(self, ctx)
        super().format_help(ctx, formatter)

    def make_parser(self, ctx: Any) -> Any:
        parser: Any = super().make_parser(ctx)
        parse = parser.parse_args

        def checked(args: list[str]) -> Any:
            values, rest, order = parse(args)
            if not ctx.resilient_parsing:
                values = checked_values(self.params, values, order)
                if values.get("json"):
                    if "form" in values:
                        raise ParameterError(
                            "--json is --format json: give one of them"
                        )
                    values["form"] = "json"
            return values, rest, order

        parser.parse_args = checked
        return parser

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

    def format_help(self, ctx: Any, formatter: Any) -> None:
        _name_types(self, ctx)
        super().format_help(ctx, formatter)

    def list_commands(self, ctx: Any) -> list[str]:
        name = self.name if self.name in help_lines() else ""
        return [other.removeprefix(f"{name} ") for other in _below(name)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        full = self._full(cmd_name)
        return (
            _Named(name=cmd_name, help=help_lines()[full])
            if full in help_lines()
            else None
        )

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        for count in (2, 1):
            name = self._full(" ".join(args[:count]))
            if name in help_lines():
                return name, self.get_command(ctx, " ".join(args[:count])), args[count:]
        raise UnknownNameError(
            "command", name, map(self._full, self.list_commands(ctx))
        )

    def _full(self, name: str) -> str:
        return f"{self.name} {name}" if self.name in help_lines() else name


class _Root(_Group):
    """The command line, which prints errors of gauge-envs without a traceback; no other place catches them."""

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        first = args[0].partition("=")[0] if args else ""
        known = {option for one in self.get_params(ctx) for option in one.opts}
        if first.startswith("-") and first not in known and not ctx.resilient_parsing:
            ctx.fail(
                f"There is no gauge {first}: write gauge --version"
                if first in ("-V", "-v")
                else f"No such option: {first}; options of a command come behind it, as in gauge run ID --seed 1"
            )
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        try:
            with command_runs():
                result = super().invoke(ctx)
        except typer.Exit as end:
            if end.exit_code:
                raise
            result = None
        except BaseException as error:
            raise typer.Exit(_exit_code(error)) from None
        # A signal that waits for the end of an import may come after the end of the command.
        if was_interrupted():
            raise typer.Exit(_exit_code(KeyboardInterrupt()))
        return result


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
    context_settings={"help_option_names": ["-h", "--help"]},
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


def _name_glfw_library() -> None:
    """State where the library of glfw is, which MuJoCo imports.

    glfw would look for it with a second Python, which ends at a path beyond ASCII in the C locale.
    """
    session = os.environ.get("XDG_SESSION_TYPE")
    windows = "wayland" if session == "wayland" else "x11"
    windows = os.environ.get("PYGLFW_LIBRARY_VARIANT", windows)
    spec = find_spec("glfw")
    for folder in [] if spec is None else spec.submodule_search_locations or []:
        for file in Path(folder).glob(f"{windows}/libglfw.so*"):
            os.environ.setdefault("PYGLFW_LIBRARY", str(file))


def main() -> None:
    """Run the `gauge` command in this process."""
    _name_glfw_library()
    handle_interrupts()
    open_closed_streams()
    app()
