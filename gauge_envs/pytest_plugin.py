"""Plugin of pytest: `pytest --gauge-engine NAME` runs the conformance checks of an engine as tests.

Each check is one test, beside those of the repository. A check that the engine declines is skipped, and a failure that
`--gauge-expected` lists is expected.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance.results import Expected


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


class CheckItem(pytest.Item):
    """One check on the engine.

    Args:
        worker: Process in which the engine runs.
        expected: What the engine is expected to fail and to decline.
    """

    def __init__(
        self, *, worker: Worker, expected: Expected | None, **kwargs: Any
    ) -> None:
        super().__init__(**kwargs)
        self._worker = worker
        self._expected = expected

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
        if self._expected is None and result.is_bad:
            pytest.fail(f"{self.name}: {result.diagnosis}", pytrace=False)
        if self._expected is not None:
            if wrong := self._expected.surprise(result):
                pytest.fail(f"{self.name} {wrong}", pytrace=False)
            if result.is_bad:
                pytest.xfail(self._expected.failures[self.name].reason)
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
    engine, file = (
        config.getoption(name) for name in ("--gauge-engine", "--gauge-expected")
    )
    if engine is None:
        if file is not None:
            raise pytest.UsageError("--gauge-expected needs --gauge-engine NAME")
        return
    from gauge_envs.backends.registry import versions_of
    from gauge_envs.errors import GaugeError
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.command import CHECK_LIMIT_S
    from gauge_envs.tools.conformance.results import read_expected

    worker = Worker(CHECK_LIMIT_S)
    config.add_cleanup(worker.close)
    try:
        expected = None if file is None else read_expected(file)
        worker.call(versions_of, engine)
    except GaugeError as error:
        raise pytest.UsageError(str(error)) from None
    for one in checks():
        item = CheckItem.from_parent(
            session,
            name=one.id,
            nodeid=f"gauge::{one.id}",
            worker=worker,
            expected=expected,
        )
        items.append(item)
