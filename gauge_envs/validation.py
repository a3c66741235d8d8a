"""Check values of users against closed sets and pydantic models."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, TypeVar

from gauge_envs.errors import ParameterError
from gauge_envs.names import nearest

if TYPE_CHECKING:
    from pydantic import ValidationError

Choice = TypeVar("Choice", bound=Enum)

UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
"""Types of pydantic's errors of a key that does not exist."""


def chosen(kind: type[Choice], value: Choice | str, name: str) -> Choice:
    """Return the member of a closed set for the value of an argument.

    Args:
        kind: The set.
        value: The value.
        name: Name of the argument, as `drivers`.

    Raises:
        ParameterError: The set has no such member; the message lists its members.
    """
    if not isinstance(value, kind) and value not in [member.value for member in kind]:
        raise ParameterError(
            f"{name} {value!r}: choose {' or '.join(repr(member.value) for member in kind)}"
        )
    return kind(value)


def first_fault(error: ValidationError, *, noun: str = "key") -> tuple[str, str]:
    """Return the place and the reason of the first fault in an error of pydantic.

    Args:
        error: Error of pydantic.
        noun: Noun for a field of the model, as `key` or `setting`.

    Returns:
        Dotted path of the field, as `score.metrics.0`, empty for the whole model; and the reason, with the value if it
        is short.
    """
    faults = error.errors(include_url=False)
    unknown = [f["loc"] for f in faults if f["type"] in UNKNOWN]
    missing = [
        str(f["loc"][-1])
        for f in faults
        if f["type"] == "missing" and f["loc"][:-1] in [loc[:-1] for loc in unknown[:1]]
    ]
    if missing:
        place, name = ".".join(map(str, unknown[0])), str(unknown[0][-1])
        return place, f"unknown {noun}; {nearest(name, missing)}"
    fault = faults[0]
    place = ".".join(map(str, fault["loc"]))
    if fault["type"] in UNKNOWN:
        return place, f"unknown {noun}"
    if fault["type"] == "missing":
        return place, f"missing {noun}"
    if fault["type"] == "union_tag_not_found":
        return f"{place}.{fault['ctx']['discriminator'].strip(chr(39))}".lstrip(
            "."
        ), f"missing {noun}"
    value = fault["input"]
    # Python cannot print integers of thousands of digits.
    is_short = isinstance(value, float | str) or (
        isinstance(value, int) and value.bit_length() <= 200
    )
    given = repr(value) if is_short else ""
    shown = f" (given: {given})" if 0 < len(given) <= 60 else ""
    return place, fault["msg"].removeprefix("Value error, ") + shown
