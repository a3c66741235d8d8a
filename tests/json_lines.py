"""Check every line with `--json` in a test against the JSON Schema of its command."""

import json
from collections.abc import Sequence
from functools import cache
from typing import Any, NoReturn

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from typer.testing import CliRunner

from gauge_envs.cli.schemas import output_schema, schema_names
from gauge_envs.tools.catalog.command import SYNONYMS

INVOKE = CliRunner.invoke


def check_invocation(
    runner: CliRunner, app: Any, args: Sequence[str] = (), **options: Any
) -> Any:
    """Run a command with `CliRunner.invoke`, and check its output with `--json`."""
    result = INVOKE(runner, app, args, **options)
    words = [str(word) for word in args]
    is_json = "--json" in words or "json" in (
        word.removeprefix("--format=")
        for before, word in zip(["", *words], words, strict=False)
        if before == "--format" or word.startswith("--format=")
    )
    if is_json:
        check_lines(schema_name(words), result.stdout)
    return result


def schema_name(words: Sequence[str]) -> str:
    """Return the name of the schema of a command line, which is that of its first two words or of the first."""
    first, *arguments = words
    if first == "list" and arguments:
        arguments[0] = SYNONYMS.get(arguments[0], arguments[0])
    two = " ".join([first, *arguments[:1]])
    return two if two in schema_names() else first


def check_lines(name: str, text: str) -> None:
    """Check the lines of an output against a schema."""
    for line in text.splitlines():
        row = json.loads(line, parse_constant=_refused)
        error = best_match(validator(name).iter_errors(row))
        assert error is None, f"{name}: {list(error.absolute_path)}: {error.message}"


@cache
def validator(name: str) -> Draft202012Validator:
    """Return the validator of a schema."""
    schema = output_schema(name)
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def _refused(text: str) -> NoReturn:
    raise AssertionError(f"{text} is no JSON")
