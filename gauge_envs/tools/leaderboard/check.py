"""Check submissions, run them, and score their results anew."""

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score, score_trajectory
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.files import json_document
from gauge_envs.pages.text import short_id
from gauge_envs.references.grades import BandGrade
from gauge_envs.runs.batch import check_requests, run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import parse_result, result_file_name
from gauge_envs.tools.leaderboard.archive import ARCHIVE, read_archive, write_archive
from gauge_envs.tools.leaderboard.submission import (
    STATEMENT_FILE,
    Fault,
    Statement,
    board_experiments,
    find_submissions,
    read_statement,
    relative_name,
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
        faults: What is wrong.
        experiments: Names of the experiments of the leaderboard.
    """

    folder: str
    statement: Statement | None = None
    results: tuple[Result, ...] = ()
    declined: tuple[str, ...] = ()
    faults: tuple[Fault, ...] = ()
    experiments: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.faults

    @property
    def standing(self) -> str | None:
        """How the table treats it; None if its statement is faulty."""
        return None if self.statement is None else self.statement.standing

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the experiments that the engine does not decline and that have no result."""
        known = {*self.declined, *(short_id(one.id) for one in self.results)}
        return tuple(name for name in self.experiments if name not in known)


@dataclass(frozen=True, kw_only=True)
class LeaderboardCheck:
    """What the check of a leaderboard found.

    Attributes:
        submissions: Its submissions, sorted by folder.
    """

    submissions: tuple[SubmissionCheck, ...]

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults of all submissions."""
        return tuple(fault for one in self.submissions for fault in one.faults)


def check_leaderboard(
    root: Path, *, run: bool = False, advance: Advance = lambda text: None
) -> LeaderboardCheck:
    """Check all submissions of a leaderboard, or a single one.

    Args:
        root: Folder of the leaderboard, or of one submission.
        run: Whether to run all experiments of each submission first, which replaces its results.
        advance: Receives the name of each file before it is checked, and of each experiment after it ran.

    Raises:
        ResultFileError: The folder holds no submission.
    """
    names = board_experiments(root)
    checks = [
        _check_submission(folder, root, names, run, advance)
        for folder in find_submissions(root)
    ]
    return LeaderboardCheck(submissions=tuple(_with_doubles_named(checks)))


def _with_doubles_named(checks: list[SubmissionCheck]) -> Iterator[SubmissionCheck]:
    """Yield the checks; all that state the same configuration, or count in ranks for the same engine, get a fault."""
    stated = [(one.folder, one.statement) for one in checks if one.statement]
    for one in checks:
        faults = [
            Fault(file=one.folder, reason=reason)
            for folder, other in stated
            if one.statement is not None and folder != one.folder
            for reason in _conflicts(one.statement, other, folder)
        ]
        yield replace(one, faults=(*one.faults, *faults))


def _conflicts(one: Statement, other: Statement, folder: str) -> Iterator[str]:
    """Yield why a submission cannot stand beside another one, which is in a folder."""
    configuration = {"engine", "version", "parameters", "settings"}
    if one.model_dump(include=configuration) == other.model_dump(include=configuration):
        yield f"has the engine, version, parameters and settings of {folder}"
    elif one.engine == other.engine and one.standing == other.standing == "ranked":
        yield f'is ranked, as {folder} is: one configuration of an engine counts in ranks; state standing = "shown"'


def _check_submission(
    folder: Path, root: Path, names: tuple[str, ...], run: bool, advance: Advance
) -> SubmissionCheck:
    checked = SubmissionCheck(folder=relative_name(folder, root), experiments=names)
    where = relative_name(folder / STATEMENT_FILE, root)
    statement = read_statement(folder / STATEMENT_FILE, where)
    if isinstance(statement, Fault):
        return replace(checked, faults=(statement,))
    checked = replace(checked, statement=statement)
    try:
        if run:
            run_submission(folder, statement, names, advance)
        files = read_archive(folder / ARCHIVE)
        outcomes = json_document(files.pop(LEFT_OUT, b"{}"))
    except (OSError, ValueError, GaugeError) as error:
        name = relative_name(folder / ARCHIVE, root)
        reason = str(error)
        if isinstance(error, OSError) and not isinstance(error, GaugeError):
            reason = f"cannot be read: {error.strerror}; --run writes it"
        return replace(checked, faults=(Fault(file=name, reason=reason),))
    results: dict[str, Result] = {}
    faults: list[Fault] = []
    for inner, content in files.items():
        name = relative_name(folder / inner, root)
        advance(name)
        try:
            result = parse_result(content, name)
        except ResultFileError as error:
            faults.append(Fault(file=name, reason=str(error).removeprefix(f"{name}: ")))
            continue
        found = list(_result_faults(result, statement, names))
        faults += [Fault(file=name, key=key, reason=reason) for key, reason in found]
        if not found:
            experiment = load_experiment(result.id, statement.parameters)
            results[short_id(result.id)] = rescored(result, experiment)
    ordered = tuple(results[name] for name in names if name in results)
    declined = tuple(
        name for name in names if outcomes.get(name) == Outcome.DECLINED.value
    )
    return replace(checked, results=ordered, declined=declined, faults=tuple(faults))


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
    installed = None
    with suppress(PackageNotFoundError):
        installed = version(statement.package)
    if installed != statement.version:
        raise ResultFileError(
            f"needs {statement.package} {statement.version}; installed here is {installed}"
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
    contents = {}
    left_out = {}
    for result in run_many(requests, isolate=None):
        advance(f"{short_id(result.id)} on {statement.engine}")
        if result.error is not None:
            left_out[short_id(result.id)] = result.outcome.value
            continue
        text = json.dumps(result.to_dict(), allow_nan=False) + "\n"
        contents[f"results/{result_file_name(result)}"] = text.encode()
    contents[LEFT_OUT] = json.dumps(left_out).encode()
    write_archive(folder / ARCHIVE, contents)


def _result_faults(
    result: Result, statement: Statement, names: tuple[str, ...]
) -> Iterator[tuple[str, str]]:
    """Yield key and reason of what makes a result another one than the submission states."""
    if short_id(result.id) not in names:
        yield "id", f"is {result.id!r}, which the leaderboard does not ask for"
        return
    experiment = load_experiment(result.id, statement.parameters)
    expected = {
        "backend": statement.engine,
        "parameters": statement.parameters,
        "settings_given": statement.settings,
        "revision": experiment.revision,
    }
    for key, value in expected.items():
        if getattr(result, key) != value:
            yield key, f"is {getattr(result, key)!r}, expected {value!r}: run it again"
    found = result.versions.get(statement.package)
    if found != statement.version:
        place = f"versions.{statement.package}"
        yield place, f"is {found!r}, expected {statement.version!r}: run it again"


def rescored(result: Result, experiment: Experiment) -> Result:
    """Return a result with the score of its trajectory by this version of the package.

    Statistics of deformation and wall times are left out: g(t) does not hold the former, and the latter are those of
    one machine.

    Args:
        result: A result.
        experiment: Its experiment.
    """
    band = reference_band(experiment)
    grade = BandGrade.NONE if band is None else band.grade
    score = Score(grade=grade.value, unit=experiment.score.observable.unit)
    if result.outcome is Outcome.FINISHED and result.trajectory is not None:
        times_s, values = result.trajectory.arrays(later=True)
        score = score_trajectory(
            experiment,
            band,
            times_s=times_s,
            values=values,
            markers_m=result.trajectory.markers_m(),
            wrenches=result.trajectory.recorded_wrenches(),
            backend=None if result.settings_given else result.backend,
            is_checked=True,
        )
    return replace(result, score=score, wall_s=None, deformation=None)
