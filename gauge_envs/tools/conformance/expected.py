"""Failures that the repository of an engine states with reasons, what is otherwise, and a badge of the result."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.files import toml_document, versions
from gauge_envs.tools.conformance.model import CheckResult, Status, checks


def read_expected(file: Path) -> dict[str, str]:
    """Return the reasons of a TOML file by the id of the check that fails, as in `rebound-flat = "no shock model"`.

    Raises:
        ParameterError: The file cannot be read, or a reason is missing.
        UnknownNameError: It names a check that does not exist.
    """
    try:
        found = toml_document(file.read_bytes())
    except (OSError, ValueError) as error:
        raise ParameterError(f"{file}: cannot be read as TOML: {error}") from None
    known = [one.id for one in checks()]
    for name, reason in found.items():
        if name not in known:
            raise UnknownNameError("check", name, known)
        if not isinstance(reason, str) or not reason.strip():
            raise ParameterError(
                f'{file}: {name} needs a reason in words, as {name} = "no model of it"'
            )
    return found


def surprise(result: CheckResult, expected: Mapping[str, str]) -> str:
    """Return what about a result is not as expected, in words; empty if it is as expected.

    Args:
        result: The result.
        expected: Reasons by the id of the checks that fail.
    """
    reason = expected.get(result.check)
    if reason is None and result.is_bad:
        value = "an error"
        if result.measured is not None:
            value = f"{result.measured:.4g} instead of {result.expected:.4g}"
        return f"fails, {value}: {result.diagnosis}"
    if reason is None or result.is_bad:
        return ""
    is_declined = result.status is Status.DECLINED
    outcome = "is declined" if is_declined else "passes"
    return f"{outcome}, but is listed as failing ({reason}): delete its line"


def badge(
    results: Sequence[CheckResult], expected: Mapping[str, str]
) -> dict[str, str | int]:
    """Return a badge as shields.io reads it from an address: green, yellow with expected failures, else red."""
    ran = [one for one in results if one.status is not Status.DECLINED]
    passed = sum(one.status is Status.PASS for one in ran)
    color = "green" if ran and passed == len(ran) else "yellow"
    if not ran or any(surprise(one, expected) for one in results):
        color = "red"
    return {
        "schemaVersion": 1,
        "label": f"gauge-envs {versions()['gauge-envs']}",
        "message": f"{passed} of {len(ran)} checks",
        "color": color,
    }
