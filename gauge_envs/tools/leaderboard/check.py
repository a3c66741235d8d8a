"""Check submissions: their files, what they state, their trajectories, their scores, and a sample run again."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from importlib.metadata import version as installed_version
from pathlib import Path

from gauge_envs.backends import backend
from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_sha256, task_spec
from gauge_envs.experiments.variants import find_variant
from gauge_envs.files import versions
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.text import counted, short_id
from gauge_envs.references.user_data import BUNDLED_DATA
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import parse_result, result_file_name
from gauge_envs.tools.leaderboard.reruns import Rerun, rerun, rerun_sample
from gauge_envs.tools.leaderboard.submission import (
    RESULTS_FOLDER,
    STATEMENT_FILE,
    Fault,
    Statement,
    SubmissionFiles,
    board_experiments,
    find_submissions,
    installed_package,
    read_statement,
    relative_name,
    submission_files,
)
from gauge_envs.tools.leaderboard.trajectory import (
    differing_scores,
    rescored,
    trajectory_faults,
)

Found = Iterator[tuple[str, str]]

HINTS = {
    "backend": f", the engine of {STATEMENT_FILE}",
    "parameters": f", as {STATEMENT_FILE} states",
    "settings_given": f", as {STATEMENT_FILE} states; settings are the same for all experiments",
    "revision": ", that of the installed task file: run it again with this version of gauge-envs",
    "seed": ": the calibrated start is run once",
}
"""What is right for a field of a result."""


@dataclass(frozen=True, kw_only=True)
class SubmissionCheck:
    """What the check of one submission found.

    Attributes:
        folder: Folder of the submission, relative to the one that was checked.
        statement: Its `submission.toml`; None if that is faulty.
        results: Results without faults, in the order of the experiments: those of episodes that were run again, else of
            the files, with scores that were computed anew.
        asked: Number of experiments of the leaderboard.
        unverified: Ids that are left out although the engine builds them, or without an engine here that could tell.
        faults: What is wrong.
        notes: What a reader should know, a sentence each.
        reruns: Episodes that were run again.
        content_sha256: Hash of names and contents of its files; empty if a file cannot be read.
    """

    folder: str
    statement: Statement | None = None
    results: tuple[Result, ...] = ()
    faults: tuple[Fault, ...] = ()
    notes: tuple[str, ...] = ()
    reruns: tuple[Rerun, ...] = ()
    content_sha256: str = ""
    asked: int = 0
    unverified: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.faults

    @property
    def is_partial(self) -> bool:
        """Whether the submission is listed apart, so that it changes no comparison of others."""
        return bool(self.unverified)


@dataclass(frozen=True, kw_only=True)
class LeaderboardCheck:
    """What the check of a leaderboard found.

    Attributes:
        submissions: Its submissions, sorted by folder.
        faults: What is wrong outside of submissions.
    """

    submissions: tuple[SubmissionCheck, ...]
    faults: tuple[Fault, ...] = ()

    @property
    def all_faults(self) -> tuple[Fault, ...]:
        """All faults, those of submissions included."""
        return (
            *self.faults,
            *(fault for one in self.submissions for fault in one.faults),
        )

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.all_faults


def check_leaderboard(
    root: Path,
    *,
    rerun_count: int = 0,
    salt: str = "",
    advance: Callable[[str], None] = lambda text: None,
) -> LeaderboardCheck:
    """Check all submissions of a leaderboard, or a single one.

    Args:
        root: Folder of the leaderboard, or of one submission.
        rerun_count: Number of episodes of each submission that are run again.
        salt: Text that the submitters do not know; it enters the choice of these episodes.
        advance: Receives the name of each file before it is checked, and of each episode before it runs.

    Raises:
        ResultFileError: The folder cannot be listed, or holds no submission.
    """
    folders, faults = find_submissions(root)
    if not folders and not faults:
        raise ResultFileError(
            f"{root}: holds no submission, as <engine>/<version>/<configuration>/{STATEMENT_FILE}"
        )
    checks = [
        _check_submission(folder, root, rerun_count, salt, advance)
        for folder in folders
    ]
    return LeaderboardCheck(
        submissions=tuple(_without_doubles(checks)), faults=tuple(faults)
    )


def _without_doubles(checks: Sequence[SubmissionCheck]) -> Iterator[SubmissionCheck]:
    """Yield the checks, with a fault for a submission whose results are of the configuration of an earlier one."""
    earlier: list[tuple[RunConfiguration, str]] = []
    for one in checks:
        if one.results:
            configuration = RunConfiguration.of(one.results[0])
            first = next(
                (folder for known, folder in earlier if known == configuration), None
            )
            if first is not None:
                reason = f"has the engine, versions, parameters and settings of {first}; a configuration counts once"
                one = replace(
                    one, faults=(*one.faults, Fault(file=one.folder, reason=reason))
                )
            earlier.append((configuration, one.folder))
        yield one


def _check_submission(
    folder: Path,
    root: Path,
    rerun_count: int,
    salt: str,
    advance: Callable[[str], None],
) -> SubmissionCheck:
    files = submission_files(folder, root)
    name = relative_name(folder, root)
    faults = list(files.faults)
    if files.statement is None:
        return SubmissionCheck(folder=name, faults=tuple(faults))
    where = relative_name(files.statement, root)
    statement = read_statement(files.statement, where)
    if isinstance(statement, Fault):
        return SubmissionCheck(folder=name, faults=(*faults, statement))
    faults += [
        Fault(file=where, key=key, reason=reason)
        for key, reason in _path_faults(folder, statement)
    ]
    names = board_experiments(root)
    results, seen, found = _checked_results(
        folder, root, files, statement, names, advance
    )
    faults += found
    faults += [
        Fault(file=where, key=key, reason=reason)
        for key, reason in _coverage_faults(statement, seen, names)
    ]
    content = files.sha256()
    reruns: list[Rerun] = []
    by_id = {result.id: file for file, result in results.items()}
    if rerun_count:
        for result in rerun_sample(
            list(results.values()), rerun_count, content_sha256=content, salt=salt
        ):
            advance(f"run {result.id}")
            compared, again = rerun(result)
            reruns.append(compared)
            if again is not None:
                results[by_id[result.id]] = rescored(
                    again, load_experiment(result.id, statement.parameters)
                )
    faults += [
        Fault(file=by_id[one.id], key="trajectory", reason=f"run again: {one}")
        for one in reruns
        if one.is_fault
    ]
    return SubmissionCheck(
        folder=name,
        statement=statement,
        results=tuple(
            sorted(
                results.values(), key=lambda result: names.index(short_id(result.id))
            )
        ),
        faults=tuple(faults),
        notes=(*_notes(results.values()), *_package_notes(statement)),
        reruns=tuple(reruns),
        content_sha256=content,
        asked=len(names),
        unverified=tuple(
            _unverified(
                statement,
                set(names) - {short_id(result.id) for result in results.values()},
            )
        ),
    )


def _unverified(statement: Statement, absent: Collection[str]) -> Iterator[str]:
    """Yield the ids of those without a result that the engine does not decline here."""
    engine = None
    with suppress(GaugeError):
        engine = backend(statement.engine)
    for name in sorted(absent):
        if engine is None or engine.supports(load_experiment(name).scene):
            yield f"GAUGE/{name}"


def _path_faults(folder: Path, statement: Statement) -> Found:
    parts = folder.resolve().parts[-3:]
    for key, part in zip(("engine", "version", "configuration"), parts, strict=False):
        if getattr(statement, key) != part:
            yield key, f"is {getattr(statement, key)!r}, but the folder is {part!r}"


def _checked_results(
    folder: Path,
    root: Path,
    files: SubmissionFiles,
    statement: Statement,
    names: Collection[str],
    advance: Callable[[str], None],
) -> tuple[dict[str, Result], set[str], list[Fault]]:
    """Return the rescored results without faults by file, the ids of all that can be read, and the faults."""
    results: dict[str, Result] = {}
    faults: list[Fault] = []
    earlier: dict[str, str] = {}
    engine_versions: dict[str, str] | None = None
    for inner, read in files.results.items():
        name = relative_name(folder / inner, root)
        advance(name)
        try:
            result = parse_result(read(), name)
        except OSError as error:
            reason = f"cannot be read: {error.strerror or error}"
            faults.append(Fault(file=name, reason=reason))
            continue
        except ResultFileError as error:
            faults.append(Fault(file=name, reason=str(error).removeprefix(f"{name}: ")))
            continue
        found = list(_result_faults(inner, result, statement, names))
        first = earlier.setdefault(result.id, name)
        if first != name:
            found.append(
                (
                    "id",
                    f"is {result.id}, which {first} has too; one result for each experiment is expected",
                )
            )
        common = {
            key: text
            for key, text in result.versions.items()
            if key not in versions() or key == "gauge-envs"
        }
        engine_versions = engine_versions or common
        if common != engine_versions:
            found.append(
                (
                    "versions",
                    f"are {_listed(common)}, but {_listed(engine_versions)} in the first file",
                )
            )
        if not found:
            experiment = load_experiment(result.id, statement.parameters)
            found = list(trajectory_faults(result, experiment))
            if not found:
                computed = rescored(result, experiment)
                found = list(differing_scores(result, computed.score))
                results |= {} if found else {name: computed}
        faults += [Fault(file=name, key=key, reason=reason) for key, reason in found]
    return results, set(earlier), faults


def _result_faults(
    file: str, result: Result, statement: Statement, names: Collection[str]
) -> Found:
    """Yield what a result states that the submission or the rules of the leaderboard do not allow."""
    if short_id(result.id) not in names:
        yield (
            "id",
            f"is {result.id!r}, which is not one of the {len(names)} experiments of the leaderboard",
        )
        return
    expected = {
        "backend": statement.engine,
        "parameters": statement.parameters,
        "settings_given": statement.settings,
        "revision": task_spec(find_variant(result.id).family).revision,
        "seed": 0,
        "jitter": {},
        "marker_proxy": MarkerProxy.MATERIAL.value,
        "dataset": BUNDLED_DATA,
        "asset": {},
    }
    for key, value in expected.items():
        if getattr(result, key) != value:
            yield (
                key,
                f"is {getattr(result, key)!r}, expected {value!r}{HINTS.get(key, '')}",
            )
    if result.outcome not in (Outcome.FINISHED, Outcome.DIVERGED):
        yield (
            "outcome",
            f"is {result.outcome.value!r}: leave the file out, and give the reason in left_out",
        )
    if result.score.withheld is not None:
        yield "score.withheld", "the reference is withheld: run without --use withheld"
    if statement.package in versions():
        packages = ", ".join(sorted(set(result.versions) - set(versions())))
        yield (
            f"versions.{statement.package}",
            f"is no package of the engine, whose packages are {packages}",
        )
    version = result.versions.get(statement.package)
    if version != statement.version:
        yield (
            f"versions.{statement.package}",
            f"is {version!r}, expected {statement.version!r}, as {STATEMENT_FILE} states",
        )
    if "gauge-envs" not in result.versions:
        yield "versions.gauge-envs", "is missing"
    if file != f"{RESULTS_FOLDER}/{result_file_name(result)}":
        yield (
            "",
            f"is named otherwise than gauge run names it: {result_file_name(result)}",
        )


def _coverage_faults(
    statement: Statement, seen: set[str], names: Sequence[str]
) -> Found:
    """Yield each experiment of the leaderboard that has neither a result nor a reason, and each reason for none."""
    present = {short_id(name) for name in seen}
    left_out: set[str] = set()
    for pattern in statement.left_out:
        stem = short_id(pattern)
        matched = [name for name in names if fnmatchcase(name, stem)]
        if not matched:
            yield f"left_out.{pattern!r}", "matches no experiment of the leaderboard"
        elif both := [name for name in matched if name in present]:
            yield f"left_out.{pattern!r}", f"also has a result: {', '.join(both)}"
        left_out.update(matched)
    missing = [name for name in names if name not in present | left_out]
    if missing:
        some = f"{', '.join(missing[:6])}{f' and {len(missing) - 6} more' if len(missing) > 6 else ''}"
        yield (
            "left_out",
            f"no result and no reason for {some}: add the files, or the reason in left_out",
        )


def _notes(results: Collection[Result]) -> Iterator[str]:
    made_with = {result.versions["gauge-envs"] for result in results}
    families = {
        find_variant(result.id).family: result.task_sha256 for result in results
    }
    if other := [
        family for family, sha256 in families.items() if sha256 != task_sha256(family)
    ]:
        yield f"task files of the same revision, but with another text than those installed: {', '.join(other)}"
    installed = versions()["gauge-envs"]
    for version in sorted(made_with - {installed}):
        yield (
            f"made with gauge-envs {version}, checked with {installed}: stated scores were not compared, "
            "those computed anew count"
        )


def _package_notes(statement: Statement) -> Iterator[str]:
    """Yield what is known of the files of the engine's package: those of the submission, and those installed here."""
    name, here = (
        f"{statement.package} {statement.version}",
        f"{statement.package} as installed here",
    )
    installed, changed = installed_package(statement.package)
    if changed:
        yield f"{here} differs from its release in {counted(len(changed), 'file')}, as {changed[0]}: install it again"
    if not installed:
        yield f"{here} has no list of its files, as an editable installation: its files were not compared"
    elif installed_version(statement.package) != statement.version:
        yield f"{name} is not installed here: its files were not compared"
    elif not statement.package_sha256:
        yield f'the files of {name} are not stated; add package_sha256 = "{installed}" if they are those installed here'
    elif statement.package_sha256 != installed:
        yield f"the files of {name} are not those installed here, {installed}: another system or build, or changed ones"


def _listed(texts: dict[str, str]) -> str:
    return ", ".join(f"{name} {text}" for name, text in sorted(texts.items())) or "none"
