"""Write the mended model of a target: the cure of a check in its file, compiled and checked before it is there."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

from gauge_envs.errors import ParameterError, ResultFileError, TargetError
from gauge_envs.files import check_replaceable, os_errors
from gauge_envs.tools.sanity.model import Report
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.stacks import configuration as configuration_of


def check_can_mend(file: Path) -> None:
    """Check that a mended model can have the name of a file."""
    if file.suffix != ".xml":
        raise ParameterError(
            f"--fix {file}: expected the name of an MJCF file, as OUT.xml"
        )
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        check_replaceable(file)


def write_mended(report: Report, file: Path) -> str:
    """Write the model of a report with its cure, unless the written file shows flags that the cure does not leave.

    Args:
        report: Report of a check with the rows that are run again.
        file: The file; its folder is created.

    Returns:
        What was written, or why nothing was, in words.

    Raises:
        TargetError: The target is not a model whose file is known, or the written model behaves otherwise.
    """
    from gauge_envs.tools.sanity.robot.mended_model import mended_xml

    checked, cure = report.configuration, report.cure
    before = set(report.flags)
    if cure is None:
        reason = "no change mends a flag" if before else "nothing is flagged"
        return f"{file} is not written: {reason}"
    if checked.robot is None or checked.robot.spec is None:
        raise TargetError(
            f"{checked.name}: --fix writes models whose MJCF file is the target: paste the change instead"
        )
    text = mended_xml(checked.robot, cure.changes, [cure.line], file.parent)
    part = file.with_name(f".{token_hex(8)}.{file.name}")
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_text(text, encoding="utf-8", newline="\n")
            after = _flags(part, report)
            new, left = after - before, after & before
            if new or len(left) > cure.flag_count - cure.mended_count:
                raise TargetError(
                    f"{file} is not written: the mended model, read again, has the flags "
                    f"{', '.join(sorted(new | left))}"
                )
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)
    gone = f"{len(before - after)} of {len(before)} flags are gone"
    return f"{file} is written, compiled and checked again: {gone}"


def _flags(file: Path, report: Report) -> set[str]:
    """Return the flagged rows of a file."""
    read = configuration_of(str(file), pair=report.configuration.robot.pair)
    measured = [
        row.phenomenon
        for row in report.rows
        if row.configured is not None or row.is_flag
    ]
    after = check(read, only=measured, include_deformables=True, explain=False)
    return set(after.flags)
