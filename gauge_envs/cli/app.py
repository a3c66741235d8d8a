"""The `gauge` command: it imports the module of a command when the command runs, and errors give an exit code."""

from __future__ import annotations

import errno
import functools
import inspect
import re
import signal
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
import typer.core

from gauge_envs.cli import arguments
from gauge_envs.cli.arguments import PER_ENGINE, split_values
from gauge_envs.cli.commands import commands, help_lines
from gauge_envs.cli.output import (
    EXIT_INTERRUPTED,
    EXIT_USAGE,
    Format,
    echo,
    message,
    quieted,
)
from gauge_envs.cli.streams import reserved_stdout
from gauge_envs.errors import GaugeError, UnknownNameError
from gauge_envs.files import path_exists

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of a full or broken disk."""


def load_command(name: str) -> Any:
    """Return a command, imported from its module, or a group of commands."""
    listed = commands().get(name)
    if listed is None:
        return _CommandGroup(name=name, help=help_lines()[name], no_args_is_help=True)
    function = listed.function()
    # Join the lines of a paragraph, because rich would keep line ends.
    text = re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(function.__doc__ or ""))
    below = [f"gauge {other}: {help_lines()[other]}" for other in _below(name)]
    epilog = "\n\n".join(["See also", *below]) if below else None
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    single.command(name, cls=_ExitingCommand, help=text, epilog=epilog)(
        _with_fields(function)
    )
    return typer.main.get_command(single)


@dataclass(frozen=True)
class CommonOptions:
    """Options of every command."""

    quiet: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT,
            "No progress, notes and totals on stderr; errors stay.",
            "--quiet",
            "-q",
        ),
    ] = False


@dataclass(frozen=True)
class JsonOption:
    """Option of commands with `--format`."""

    json: Annotated[
        bool,
        arguments.option(arguments.OUTPUT, "Short for --format json.", "--json"),
    ] = False


def _with_fields(function: Any) -> Any:
    """Return a command that has an option for each field of its dataclasses of options, and the common options.

    Args:
        function: The function of the command. A parameter whose type is a dataclass gets an instance of it.
    """
    classes: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        if is_dataclass(parameter.annotation):
            classes[parameter.name] = parameter.annotation
            parameters += _parameters_of(parameter.annotation)
        else:
            parameters.append(parameter)
    parameters += _parameters_of(CommonOptions)
    if any(parameter.name == "form" for parameter in parameters):
        parameters += _parameters_of(JsonOption)

    @functools.wraps(function)
    def command(**values: Any) -> Any:
        if values.pop("json", False):
            values["form"] = Format.JSON
        is_quiet = values.pop("quiet")
        for name, cls in classes.items():
            own = {field.name: values.pop(field.name) for field in fields(cls)}
            values[name] = cls(**own)
        with quieted(is_quiet):
            return function(**values)

    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def _parameters_of(cls: Any) -> list[inspect.Parameter]:
    """Return a parameter for each field of a dataclass."""
    types = get_type_hints(cls, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=types[field.name],
        )
        for field in fields(cls)
    ]


def _below(name: str) -> list[str]:
    """Return the names of the commands below a name; the empty name is the command line itself."""
    return [
        command_name
        for command_name in help_lines()
        if command_name.rpartition(" ")[0] == name
    ]


LISTED = ("ID", "KIND or PATTERN", "NAME", "PATTERN")
"""Metavars of arguments with lists of names, not of paths."""


def _split_lists(command: Any, values: dict[str, Any]) -> None:
    """Split the values of options and arguments with lists at commas.

    Args:
        command: The command.
        values: Values by the names of the parameters; lists change.
    """
    for parameter in command.params:
        metavar = parameter.metavar or ""
        is_list = getattr(parameter, "multiple", False)
        if metavar in LISTED and parameter.nargs == -1:
            # Settings after an engine belong to it.
            is_list, metavar = True, PER_ENGINE
        if is_list and values[parameter.name]:
            values[parameter.name] = [
                part
                for value in values[parameter.name]
                for part in _separated(value, metavar)
            ]


def _separated(value: str | Path, metavar: str) -> list[str | Path]:
    """Return the parts of a value between commas; the name of an existing file stays whole."""
    if path_exists(value):
        return [value]
    return [type(value)(part) for part in split_values(str(value), metavar)]


class _ExitingCommand(typer.core.TyperCommand):
    """Command whose function returns its exit code, or whether it failed.

    Its stdout has only results, even if engines print.
    """

    def invoke(self, ctx: Any) -> Any:
        _split_lists(self, ctx.params)
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
            # True is exit code 1; a number is the exit code.
            raise typer.Exit(int(has_failed))


class _Named(typer.core.TyperCommand):
    """Name and help line of a command, which is imported when its arguments are parsed."""

    def make_context(
        self, info_name: Any, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        return load_command(str(info_name)).make_context(
            info_name, args, parent=parent, **extra
        )


class _CommandGroup(typer.core.TyperGroup):
    """Commands by name; a name may have two words, as `sanity probe` next to `sanity TARGET`."""

    def list_commands(self, ctx: Any) -> list[str]:
        name = self.name if self.name in help_lines() else ""
        return [command_name.removeprefix(f"{name} ") for command_name in _below(name)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        text = help_lines().get(self._full(cmd_name))
        if text is None:
            return None
        return _Named(name=cmd_name, help=text)

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


class _Root(_CommandGroup):
    """The command line, which prints errors of gauge-envs without a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo("interrupted", err=True)
            raise typer.Exit(EXIT_INTERRUPTED) from None
        except GaugeError as error:
            text = str(error)
        except OSError as error:
            if error.errno not in UNWRITABLE:
                raise
            text = f"the output cannot be written: {error.strerror}"
        message(text, "error")
        raise typer.Exit(EXIT_USAGE)


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
    """Separate errors of a simulation by their cause: engine, settings or constants (GAUGE benchmark)."""


def main() -> None:
    """Run the `gauge` command in this process."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    app()
