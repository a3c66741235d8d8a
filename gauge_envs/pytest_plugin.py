"""Plugin of pytest: `pytest --gauge-engine NAME` runs the conformance checks of an engine as tests.

Each check is one test, beside those of the repository. A check that the engine does not support is skipped, and a
failure that `--gauge-expected` lists is expected. With `--gauge-baseline` a test fails if the check became worse or its
value moved by more than its tolerance since the earlier release.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gauge_envs.runs.workers import Worker
    from gauge_envs.tools.conformance.expectations import Expectation


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
        expectation: Results that are expected; None for passed checks.
    """

    def __init__(
        self, *, worker: Worker, expectation: Expectation | None, **kwargs: Any
    ) -> None:
        super().__init__(**kwargs)
        self._worker = worker
        self._expectation = expectation

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
        difference = None
        if self._expectation is not None:
            difference = self._expectation.difference(result)
        elif result.is_bad:
            difference = f"fails: {result.diagnosis}"
        if difference is not None:
            pytest.fail(f"{self.name} {difference}", pytrace=False)
        if result.is_bad:
            pytest.xfail(result.diagnosis)
        if result.missing:
            pytest.skip("; ".join(result.missing))

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Return where it is listed."""
        return self.path, None, f"gauge: {self.name}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Add a test for each check."""
    engine = config.getoption("--gauge-engine")
    expected = config.getoption("--gauge-expected")
    baseline = config.getoption("--gauge-baseline")
    if engine is None:
        if expected or baseline:
            option = "--gauge-expected" if expected else "--gauge-baseline"
            raise pytest.UsageError(f"{option} needs --gauge-engine NAME")
        return
    from gauge_envs.backends.registry import versions_of
    from gauge_envs.errors import GaugeError
    from gauge_envs.runs.workers import Worker
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.command import CHECK_LIMIT_S
    from gauge_envs.tools.conformance.expectations import expectation_of

    worker = Worker(CHECK_LIMIT_S)
    config.add_cleanup(worker.close)
    try:
        expectation = expectation_of(engine, expected, baseline)
        worker.call(versions_of, engine)
    except GaugeError as error:
        raise pytest.UsageError(str(error)) from None
    for check in checks():
        item = CheckItem.from_parent(
            session,
            name=check.id,
            nodeid=f"gauge::{check.id}",
            worker=worker,
            expectation=expectation,
        )
        items.append(item)
