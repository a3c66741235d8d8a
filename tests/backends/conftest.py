"""The installed engines, for tests of what all of them must do."""

from __future__ import annotations

import pytest

from gauge_envs.backends import Backend, backend, backend_names
from gauge_envs.errors import MissingExtraError


def engine_or_skip(name: str) -> Backend:
    """Return an engine by name; a test of one that is not installed is skipped."""
    try:
        return backend(name)
    except MissingExtraError as error:
        pytest.skip(str(error))


@pytest.fixture(params=backend_names())
def engine(request: pytest.FixtureRequest) -> Backend:
    """Each installed engine in turn, or the engines that a test names by indirect parameters."""
    return engine_or_skip(request.param)
