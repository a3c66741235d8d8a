"""Write the model of a target with the fix; the files are compiled and checked before they are replaced."""

from dataclasses import replace
from pathlib import Path
from secrets import token_hex

from gauge_envs.errors import ParameterError, ResultFileError, TargetError
from gauge_envs.files import check_replaceable, os_errors
from gauge_envs.pages.document import save_file
from gauge_envs.tools.sanity.fixes.named import write_named
from gauge_envs.tools.sanity.fixes.text_change import TextChange, write_change
from gauge_envs.tools.sanity.readers import configuration as configuration_of
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.verdict import Report


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
    """Write a report's model with all fixes, unless checks that they resolve fail in the written file.

    Args:
        report: Report of a check.
        file: The file; its folder is created. Included files that change are written beside it.

    Returns:
        A sentence: what was written, or why nothing was.

    Raises:
        TargetError: The target's text is unknown or not MJCF, or the written model does not compile or fails further
            checks.
    """
    if report.fix is None and not any(result.fix for result in report.checks):
        reason = "no change resolves a check" if report.flags else "all checks passed"
        return f"{file} is not written: {reason}"
    text, resolved = _changed_text(report)
    text.move(file.parent)
    trial = text.texts(file.with_name(f".{token_hex(8)}.{file.name}"))
    try:
        for path, content in trial.items():
            save_file(path, content)
        after = _flags(next(iter(trial)), report)
    finally:
        for path in trial:
            path.unlink(missing_ok=True)
    before = {
        result.id
        for result in report.checks
        if result.verdict.is_off and result.cause not in resolved
    }
    if unexpected := after - (before - resolved):
        if report.fix is not None and any(result.fix for result in report.checks):
            # The settings were tried without the changes of attributes.
            return write_fix(replace(report, fix=None), file)
        raise TargetError(
            f"{file} is not written: the fixed model, read again, does not pass {', '.join(sorted(unexpected))}"
        )
    for path, content in text.texts(file).items():
        save_file(path, content)
    gone = report.flags.keys() - after
    return f"{file} is written and checked again: {len(gone)} of {len(report.flags)} findings are resolved"


def _changed_text(report: Report) -> tuple[TextChange, set[str]]:
    """Return the text of a report's model with all fixes, and the ids of the checks that they resolve.

    Raises:
        TargetError: The text is unknown or not MJCF.
    """
    robot, fix = report.configuration.robot, report.fix
    assert robot is not None, "only a model has fixes"
    text, _ = write_change(robot, {} if fix is None else fix.changes)
    if text is None or text.model.root.tag != "mujoco":
        raise TargetError(
            f"{report.configuration.name}: --fix changes the text of an MJCF file, which the target "
            "is not: paste the fix instead"
        )
    return text, {*(fix.fixed if fix else ()), *write_named(report.checks, robot, text)}


def _flags(file: Path, report: Report) -> set[str]:
    """Return the failed checks and warnings of a file with a report's model."""
    robot = report.configuration.robot
    measured = [
        result.id
        for result in report.checks
        if result.configured is not None or result.is_flag
    ]
    after = check(
        configuration_of(str(file), pair=robot.pair if robot else None),
        only=measured,
        explain=False,
    )
    return set(after.flags)
