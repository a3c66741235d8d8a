"""Write the model of a target with the fix; the file is compiled and checked again before it is replaced."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

from gauge_envs.errors import ParameterError, ResultFileError, TargetError
from gauge_envs.files import check_replaceable, os_errors
from gauge_envs.tools.sanity.fixes.text_change import TextChange, write_change
from gauge_envs.tools.sanity.readers import configuration as configuration_of, dialect
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.verdict import Fix, Report


def check_can_fix(file: Path) -> None:
    """Check that a fixed model can be written to a file."""
    if file.suffix != ".xml":
        raise ParameterError(
            f"--fix {file}: expected the name of an MJCF file, as OUT.xml"
        )
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        check_replaceable(file)


def write_fix(report: Report, file: Path) -> str:
    """Write a report's model with the fix, unless checks that the fix resolves fail in the written file.

    Args:
        report: Report of a check.
        file: The file; its folder is created.

    Returns:
        A sentence: what was written, or why nothing was.

    Raises:
        TargetError: The target's text is unknown or not MJCF, an included file has to change, or the written model does
            not compile or fails further checks.
    """
    fix, before = report.fix, set(report.flags)
    if fix is None:
        reason = "no change resolves a check" if before else "all checks passed"
        return f"{file} is not written: {reason}"
    text = _changed_text(report, fix)
    if text.elsewhere:
        raise TargetError(
            f"{file} is not written: change {', '.join(text.elsewhere)}, which {text.model.file.name} includes"
        )
    text.move(file.parent)
    part = file.with_name(f".{token_hex(8)}.{file.name}")
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_text(text.text(text.model.file), encoding="utf-8", newline="")
            after = _flags(part, report)
            unexpected = after - (before - set(fix.fixed))
            if unexpected:
                raise TargetError(
                    f"{file} is not written: the fixed model, read again, does not pass {', '.join(sorted(unexpected))}"
                )
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)
    return f"{file} is written and checked again: {len(before - after)} of {len(before)} findings are resolved"


def _changed_text(report: Report, fix: Fix) -> TextChange:
    """Return the text of a report's model with the fix.

    Raises:
        TargetError: The text is unknown or not MJCF.
    """
    checked = report.configuration
    text = None
    if checked.robot is not None:
        language = dialect(checked.language)
        text, _ = write_change(checked.robot, language, fix.changes)
    if text is None or text.model.root.tag != "mujoco":
        raise TargetError(
            f"{checked.name}: --fix changes the text of an MJCF file, which the target is not: paste the fix instead"
        )
    return text


def _flags(file: Path, report: Report) -> set[str]:
    """Return the failed checks and warnings of a file with a report's model."""
    robot = report.configuration.robot
    pair = None if robot is None else robot.pair
    measured = [
        result.id
        for result in report.checks
        if result.configured is not None or result.is_flag
    ]
    after = check(
        configuration_of(str(file), pair=pair),
        only=measured,
        explain=False,
    )
    return set(after.flags)
