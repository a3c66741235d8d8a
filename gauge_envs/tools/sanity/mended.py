"""Write the model of a target with the change that its check found, compiled and checked again before it is there."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

from gauge_envs.errors import ParameterError, ResultFileError, TargetError
from gauge_envs.files import check_replaceable, os_errors
from gauge_envs.tools.sanity.model import Report
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.stacks import configuration as configuration_of, dialect


def check_can_mend(file: Path) -> None:
    """Check that a changed model can have the name of a file."""
    if file.suffix != ".xml":
        raise ParameterError(
            f"--fix {file}: expected the name of an MJCF file, as OUT.xml"
        )
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        check_replaceable(file)


def write_mended(report: Report, file: Path) -> str:
    """Write the text of a report's model with the change, unless the written file has flags that the change removes.

    Args:
        report: Report of a check with the rows that are run again.
        file: The file; its folder is created.

    Returns:
        What was written, or why nothing was, in words.

    Raises:
        TargetError: The target's text is not known or not MJCF, another file states what changes, or the written model
            does not compile or has further flags.
    """
    checked, cure = report.configuration, report.cure
    before = set(report.flags)
    if cure is None:
        reason = "no change corrects a flag" if before else "nothing is flagged"
        return f"{file} is not written: {reason}"
    text = None
    if checked.robot is not None:
        from gauge_envs.tools.sanity.robot.mended_model import write_change

        words = dialect(checked.language)
        text, _ = write_change(checked.robot, words, cure.changes)
    if text is None or text.model.root.tag != "mujoco":
        raise TargetError(
            f"{checked.name}: --fix changes the text of an MJCF file, which the target is not: paste the change instead"
        )
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
            left = after - (before - set(cure.mended))
            if left:
                raise TargetError(
                    f"{file} is not written: the changed model, read again, has the flags {', '.join(sorted(left))}"
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
