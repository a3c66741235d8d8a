"""Plugin of pytest: `pytest --gauge-engine NAME` runs the conformance checks of an engine as tests.

Each check is one test, beside those of the repository. A check that the engine does not support is skipped, and a
failure that `--gauge-expected` lists is expected. With `--gauge-baseline` a test fails if the check became worse or its
value moved by more than its tolerance since the earlier release.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gauge_envs.runs.workers import Worker
    from gauge_envs.tools.conformance.model import CheckResult
    from gauge_envs.tools.conformance.results import EngineColumn, Expected


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("gauge-envs")
    group.addoption(
        "--gauge-engine", metavar="NAME", help="engine that the checks run on"
    )
    group.addoption(
        "--gauge-expected",
        metavar="FILE",
        type=Path,
        help='TOML of checks that fail, as in: rebound-flat = { measured = 0.513, reason = "no model" }',
    )
    group.addoption(
        "--gauge-baseline",
        metavar="FILE",
        type=Path,
        help="JSON of an earlier release, from gauge backend check NAME --out FILE.json",
    )


class CheckItem(pytest.Item):
    """One check on the engine.

    Args:
        worker: Process in which the engine runs.
        expected: Failures and unsupported checks that are expected; None if no file lists them.
        baseline: Results of earlier releases; empty if no file has them.
    """

    def __init__(
        self,
        *,
        worker: Worker,
        expected: Expected | None,
        baseline: Sequence[EngineColumn],
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self._worker = worker
        self._expected = expected
        self._baseline = baseline

    def runtest(self) -> None:
        """Run the check."""
        from gauge_envs.tools.conformance import run_checks

        engine = self.config.getoption("--gauge-engine")
        (result,) = run_checks(engine, only=[self.name], worker=self._worker)
        facts = result.to_dict()
        self.user_properties += [
            (key, facts[key])
            for key in ("measured", "expected", "fingerprint", "versions", "gauge_envs")
        ]
        if failure := self._failure(result):
            pytest.fail(f"{self.name} {failure}", pytrace=False)
        if result.is_bad:
            pytest.xfail(result.diagnosis)
        if result.missing:
            pytest.skip("; ".join(result.missing))

    def _failure(self, result: CheckResult) -> str:
        """Return why the test fails, in words; empty if it passes."""
        if self._expected is not None:
            return self._expected.surprise(result)
        if self._baseline:
            return self._difference(result)
        return f"fails: {result.diagnosis}" if result.is_bad else ""

    def _difference(self, result: CheckResult) -> str:
        """Return how a result became worse or moved since the baseline, in words; empty if it did not."""
        from gauge_envs.tools.conformance.results import EngineColumn, changes

        column = EngineColumn(backend=result.backend, name="default", settings={})
        column.results[result.check] = result
        for change in changes([column], self._baseline):
            if change.kind != "fixed":
                before, after = (
                    f"{outcome.status}, {outcome.measured}"
                    for outcome in (change.before, change.after)
                )
                return f"{change.kind}: {before} before, {after} now"
        return ""

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Return where it is listed."""
        return self.path, None, f"gauge: {self.name}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Add a test for each check."""
    engine = config.getoption("--gauge-engine")
    files = {
        option: config.getoption(option)
        for option in ("--gauge-expected", "--gauge-baseline")
    }
    given = [option for option, file in files.items() if file is not None]
    if engine is None:
        if given:
            raise pytest.UsageError(f"{given[0]} needs --gauge-engine NAME")
        return
    if len(given) == 2:
        raise pytest.UsageError(f"give one of {' and '.join(given)}")
    from gauge_envs.backends.registry import versions_of
    from gauge_envs.errors import GaugeError
    from gauge_envs.runs.workers import Worker
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.command import CHECK_LIMIT_S
    from gauge_envs.tools.conformance.results import read_columns, read_expected

    expected_file, baseline_file = files.values()
    worker = Worker(CHECK_LIMIT_S)
    config.add_cleanup(worker.close)
    try:
        expected = read_expected(expected_file) if expected_file else None
        baseline = read_columns(baseline_file) if baseline_file else []
        worker.call(versions_of, engine)
    except GaugeError as error:
        raise pytest.UsageError(str(error)) from None
    for check in checks():
        item = CheckItem.from_parent(
            session,
            name=check.id,
            nodeid=f"gauge::{check.id}",
            worker=worker,
            expected=expected,
            baseline=baseline,
        )
        items.append(item)
