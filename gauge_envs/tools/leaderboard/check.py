"""Check submissions, run them, and score their results anew."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from gauge_envs.backends.registry import backend as find_backend, versions_of
from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.files import json_document, printable
from gauge_envs.pages.text import pairs_text, short_id
from gauge_envs.runs.batch import check_requests, run_many
from gauge_envs.runs.episodes import rescored
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import parse_result, result_file_name
from gauge_envs.tools.leaderboard.archive import ARCHIVE, read_archive, write_archive
from gauge_envs.tools.leaderboard.submission import (
    STATEMENT_FILE,
    Statement,
    board_experiments,
    find_submissions,
    read_statement,
)

LEFT_OUT = "left_out.json"
"""File of an archive with the outcome of each experiment that has no result, `declined` or `failed`, by its name."""

Advance = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class SubmissionCheck:
    """What the check of one submission found.

    Attributes:
        folder: Folder of the submission, relative to the one that was checked.
        statement: Its `submission.toml`; None if that is faulty.
        results: Results without faults, in the order of the experiments, with scores that were computed anew.
        declined: Names of the experiments that the engine cannot build.
        missing: Names of the others that have no result.
        faults: What is wrong, as `submission.toml: format: missing key`.
    """

    folder: str
    statement: Statement | None = None
    results: tuple[Result, ...] = ()
    declined: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def ranked_engine(self) -> str | None:
        """Engine that it counts for in ranks; None for none."""
        stated = self.statement
        return stated.engine if stated and stated.standing == "ranked" else None


def check_leaderboard(
    root: Path, *, run: bool = False, advance: Advance = lambda text: None
) -> tuple[SubmissionCheck, ...]:
    """Check all submissions of a leaderboard, or a single one.

    Args:
        root: Folder of the leaderboard, or of one submission.
        run: Whether to run all experiments of each submission first, which replaces its results.
        advance: Receives the name of each experiment after it ran.

    Returns:
        The checks, sorted by folder.

    Raises:
        ResultFileError: The folder holds no submission.
    """
    names = board_experiments(root)
    checks = []
    for folder in find_submissions(root):
        place = printable(folder.relative_to(root).as_posix())
        checked = SubmissionCheck(folder=place, missing=names)
        try:
            statement = read_statement(folder / STATEMENT_FILE)
        except (OSError, ValueError) as error:
            checks.append(_with_fault(checked, STATEMENT_FILE, error))
            continue
        checked = replace(checked, statement=statement)
        try:
            if run:
                run_submission(folder, statement, names, advance)
            checked = _with_results(checked, statement, folder, names)
        except (OSError, ValueError, GaugeError) as error:
            checked = _with_fault(checked, ARCHIVE, error)
        checks.append(checked)
    ranked = Counter(one.ranked_engine for one in checks)
    del ranked[None]
    return tuple(
        _with_fault(one, STATEMENT_FILE, ResultFileError(RIVALS))
        if ranked[one.ranked_engine] > 1
        else one
        for one in checks
    )


RIVALS = (
    "another one of this engine is ranked too, and one configuration of an engine counts in ranks: state "
    'standing = "shown"'
)


def _with_fault(
    checked: SubmissionCheck, file: str, error: Exception
) -> SubmissionCheck:
    reason = str(error)
    if isinstance(error, OSError) and not isinstance(error, GaugeError):
        hint = "; --run writes it" if file == ARCHIVE else ""
        reason = f"cannot be read: {error.strerror}{hint}"
    return replace(checked, faults=(*checked.faults, f"{file}: {reason}"))


def _with_results(
    checked: SubmissionCheck,
    statement: Statement,
    folder: Path,
    names: tuple[str, ...],
) -> SubmissionCheck:
    """Return a check with the results of the archive of a submission, or with what is wrong with them."""
    files = read_archive(folder / ARCHIVE)
    outcomes = json_document(files.pop(LEFT_OUT, b"{}"))
    if not isinstance(outcomes, dict):
        raise ValueError(f"{LEFT_OUT} holds no object")
    results: dict[str, Result] = {}
    for name, content in files.items():
        try:
            result = _checked_result(content, printable(name), statement, names)
        except ResultFileError as error:
            checked = _with_fault(checked, ARCHIVE, error)
        else:
            results[short_id(result.id)] = result
    declined = [name for name in names if outcomes.get(name) == Outcome.DECLINED.value]
    return replace(
        checked,
        results=tuple(results[name] for name in names if name in results),
        declined=tuple(declined),
        missing=tuple(name for name in names if name not in {*results, *declined}),
    )


def run_submission(
    folder: Path, statement: Statement, names: tuple[str, ...], advance: Advance
) -> None:
    """Run all experiments of a submission with the engine that is installed here, and write its results.

    Args:
        folder: Folder of the submission.
        statement: What it states.
        names: Names of the experiments.
        advance: Receives the name of each experiment after it ran.

    Raises:
        GaugeError: The installed version is not the stated one, or the engine or its settings do not exist.
    """
    installed = versions_of(statement.engine)
    if installed.get(statement.package) != statement.version:
        raise ResultFileError(
            f"needs {statement.package} {statement.version}; installed here: {pairs_text(installed)}"
        )
    requests = [
        RunRequest(
            name,
            backend=statement.engine,
            parameters=statement.parameters,
            settings=statement.settings or None,
        )
        for name in names
    ]
    check_requests(requests, isolate=None)
    _check_repeatability(statement)
    contents: dict[str, bytes] = {}
    left_out: dict[str, str] = {}
    for result in run_many(requests, isolate=None):
        advance(f"{short_id(result.id)} on {statement.engine}")
        if result.error is None and not contents and statement.standing == "ranked":
            _check_repeated(result, requests[names.index(short_id(result.id))])
        if result.error is not None:
            left_out[short_id(result.id)] = result.outcome.value
            continue
        text = json.dumps(result.to_dict(), allow_nan=False) + "\n"
        contents[f"results/{result_file_name(result)}"] = text.encode()
    contents[LEFT_OUT] = json.dumps(left_out).encode()
    write_archive(folder / ARCHIVE, contents)


def _check_repeatability(statement: Statement) -> None:
    """Raise `ResultFileError` if an engine is to be ranked whose runs differ: its rank would be that of one run."""
    declared = find_backend(statement.engine).repeatability(statement.settings)
    if statement.standing == "ranked" and declared.kind != "bits":
        raise ResultFileError(
            f"{statement.engine} declares that its runs do not repeat bits (repeatability {declared.kind!r}), and a "
            'rank is that of one run: state standing = "shown"'
        )


def _check_repeated(result: Result, request: RunRequest) -> None:
    """Run an experiment again; raise `ResultFileError` if its trajectory has other bits."""
    (again,) = run_many([request], isolate=None)
    first, second = (one.to_dict()["trajectory"] for one in (result, again))
    if first != second:
        raise ResultFileError(
            f"{result.id}: two runs have different trajectories, but a ranked engine repeats bits: mend it, or declare "
            'it in Backend.repeatability and state standing = "shown"'
        )


def _checked_result(
    content: bytes, name: str, statement: Statement, names: tuple[str, ...]
) -> Result:
    """Return a result of a submission with the score of its trajectory.

    Statistics of deformation and wall times are left out: g(t) does not hold the former, and the latter are those of
    one machine.

    Raises:
        ResultFileError: It is no result, or another one than the submission states.
    """
    result = parse_result(content, name)
    if short_id(result.id) not in names:
        raise ResultFileError(f"{name}: the leaderboard does not ask for {result.id!r}")
    experiment = load_experiment(result.id, statement.parameters)
    package = statement.package
    expected = {
        "backend": (result.backend, statement.engine),
        "parameters": (result.parameters, statement.parameters),
        "settings_given": (result.settings_given, statement.settings),
        "revision": (result.revision, experiment.revision),
        f"versions.{package}": (result.versions.get(package), statement.version),
    }
    for key, (found, stated) in expected.items():
        if found != stated:
            raise ResultFileError(
                f"{name}: {key} is {found!r}, expected {stated!r}: run it again"
            )
    backend = None if result.settings_given else result.backend
    scored = rescored(result, experiment, reference_band(experiment), backend)
    if result.outcome is not Outcome.FINISHED:
        empty = Score(grade=result.score.grade, unit=result.score.unit)
        scored = replace(result, score=empty)
    return replace(scored, wall_s=None, deformation=None)
