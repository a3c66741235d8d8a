"""Commands in forks of one process, which has the imports behind it: each has streams and an exit code of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

DRIVER = """
import gc, json, os, sys
import fork_server
from gauge_envs.runs import isolation
import gauge_envs.cli.app, gauge_envs.runs.batch, gauge_envs.tools.catalog.listing
from gauge_envs.experiments.variants import find_variant

# What the list of an experiment loads is then there for every fork.
gauge_envs.tools.catalog.listing.list_rows([find_variant("SlopeSlider-2-wood")])
if sys.platform == "linux":
    # Engines of other packages answer in forks too.
    isolation.subprocess = fork_server.STAND_IN
    fork_server.start()
# The end of a fork would otherwise copy all that the imports have made.
gc.collect()
gc.freeze()
cases, folder = json.loads(sys.argv[1]), sys.argv[2]
codes = []
for number, case in enumerate(cases):
    pid = os.fork()
    if not pid:
        break
    codes.append(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
else:
    print(json.dumps(codes))
    sys.exit()
for fd, name in enumerate(("stdin", "stdout", "stderr")):
    place = case["streams"].get(name, f"{folder}/{number}.{name}" if fd else os.devnull)
    if place == "broken pipe":
        reading, writing = os.pipe()
        os.dup2(writing, fd)
        os.close(reading)
        os.close(writing)
    else:
        opened = os.open(place, os.O_RDWR | os.O_CREAT)
        os.dup2(opened, fd)
        os.close(opened)
sys.argv = ["gauge", *case["arguments"]]
exec(case["before"])
from gauge_command import main

main()
"""
"""What the process does: the end of a fork is that of the interpreter, so that all that is held back is written."""


@dataclass(frozen=True)
class Case:
    """A command.

    Attributes:
        arguments: Its arguments.
        before: Code that runs before it.
        streams: Path of stdin, stdout or stderr, or `broken pipe`; files that are read back by default.
    """

    arguments: Sequence[str]
    before: str = ""
    streams: Mapping[str, str] = field(default_factory=dict)


def run_forks(cases, folder, environment):
    """Run commands one after another in a folder, and return their outcomes."""
    outputs = folder / "outputs"
    outputs.mkdir()
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            DRIVER,
            json.dumps([asdict(case) for case in cases.values()]),
            str(outputs),
        ],
        cwd=folder,
        env={
            **environment,
            "PYTHONPATH": os.pathsep.join(
                [environment["PYTHONPATH"], str(Path(__file__).parent)]
            ),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    codes = json.loads(done.stdout)

    def text(number, name):
        file = outputs / f"{number}.{name}"
        return file.read_text() if file.exists() else ""

    return {
        name: subprocess.CompletedProcess(
            case.arguments, code, text(number, "stdout"), text(number, "stderr")
        )
        for number, ((name, case), code) in enumerate(
            zip(cases.items(), codes, strict=True)
        )
    }
