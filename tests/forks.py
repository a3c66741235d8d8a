"""Commands in processes of their own, with full devices and broken pipes as streams."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

MAIN = """
import sys
sys.argv[0] = "gauge"
from gauge_command import main
main()
"""


@dataclass(frozen=True)
class Case:
    """A command.

    Attributes:
        arguments: Its arguments.
        before: Code that runs before it.
        streams: Path of stdout or stderr, or `broken pipe`; by default the text is read back.
    """

    arguments: Sequence[str]
    before: str = ""
    streams: Mapping[str, str] = field(default_factory=dict)


def run_forks(cases, folder, environment):
    """Run commands in a folder, and return their outcomes by name."""
    return {name: _run(case, folder, environment) for name, case in cases.items()}


def _run(case, folder, environment):
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    for name, place in case.streams.items():
        if place == "broken pipe":
            reading, streams[name] = os.pipe()
            os.close(reading)
        else:
            streams[name] = os.open(place, os.O_WRONLY)
    code = f"import sys\n{case.before}\n{MAIN}"
    done = subprocess.run(
        [sys.executable, "-c", code, *case.arguments],
        cwd=folder,
        env=environment,
        text=True,
        check=False,
        **streams,
    )
    for name in case.streams:
        os.close(streams[name])
    return done
