"""The command `gauge`, run in this process."""

import pytest
from typer.testing import CliRunner

from gauge_envs.cli.app import app


@pytest.fixture
def gauge():
    return lambda *arguments: CliRunner(env={"COLUMNS": "200"}).invoke(
        app, list(map(str, arguments))
    )
