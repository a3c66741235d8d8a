"""Folder and processes of the comparisons on one model."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import GaugeError
from gauge_envs.tools.versions.environments import made_environment
from gauge_envs.tools.versions.model import Side
from gauge_envs.tools.versions.subject import read_subject

WORKER = ("-I", "-B", str(Path(__file__).with_name("worker.py")))
"""Arguments of Python for the worker; with `-I` no path of the user's counts, and no module beside the script."""

WORKER_LIMIT_S = 3600.0
"""Time of a process [s]."""

Arrays: TypeAlias = Mapping[str, NDArray[Any]]


class VersionsError(GaugeError, RuntimeError):
    """A version cannot run a model; the message names both and the cause."""


@dataclass(frozen=True)
class Observed:
    """What one side computed.

    Attributes:
        side: The side.
        words: The compiled model, and what became of each segment.
        probes: What one step gives from the states of each file.
    """

    side: Side
    words: Mapping[str, Any]
    probes: tuple[Arrays, ...] = ()


class Bench:
    """Folder and processes of comparisons on one model.

    Args:
        model: The model file.
        folder: Folder of the files of the processes.
        steps: Steps of each segment.
        seed: Seed of controls and pushes.
        saved: NPZ of saved states, which replace the segments; or None.
        motion: NPZ of the motion of driven bodies; or None.
        title: The model as the user named it; its file by default.
        say: Prints what is installed.
    """

    def __init__(
        self,
        model: Path,
        folder: Path,
        *,
        steps: int,
        seed: int,
        saved: Path | None = None,
        motion: Path | None = None,
        title: str = "",
        say: Callable[[str], object] = print,
    ) -> None:
        self.model = model
        self.title = title or str(model)
        self._folder = folder
        self._motion: dict[str, Any] = {"steps": steps, "seed": seed}
        if saved is not None:
            self._motion["saved"] = str(saved.resolve())
        if motion is not None:
            self._motion["driven"] = str(motion)
        self._say = say
        # Both sides may ask for a number at once.
        self._numbers = itertools.count(1)

    def run(self, side: Side) -> tuple[Observed, Path]:
        """Move the model on one side; return what it compiled, and the file of the states that it visits."""
        words = self.work(side, {"run": self._motion})
        return Observed(side, words), Path(f"{words['out']}.run.npz")

    def probe(
        self,
        side: Side,
        files: Sequence[Path],
        *,
        exact: Mapping[str, Any] | None = None,
    ) -> Observed:
        """Compute one step from each state of files.

        Args:
            side: The side.
            files: NPZ of states.
            exact: Settings with which all is computed a second time, behind the first; with the poses of all geoms.
        """
        job = {"states": [str(file) for file in files], "exact": exact}
        words = self.work(side, job)
        count = len(files) if exact is None else 2 * len(files)
        probes = tuple(
            arrays(Path(f"{words['out']}.probe{index}.npz")) for index in range(count)
        )
        return Observed(side, words, probes)

    def kept(self, rows: dict[str, Any]) -> Path:
        """Write states to a file."""
        file = self._folder / f"states{next(self._numbers)}.npz"
        np.savez(file, **rows)
        return file

    def work(
        self, side: Side, job: Mapping[str, Any], worker: Sequence[str] = WORKER
    ) -> dict[str, Any]:
        """Do a job on a side; return what the worker wrote, and the start `out` of the names of its files."""
        out = self._folder / f"job{next(self._numbers)}"
        whole: dict[str, Any] = {"model": str(self.model.resolve()), **job}
        whole |= {"settings": dict(side.settings), "out": str(out)}
        file = Path(f"{out}.job.json")
        file.write_text(json.dumps(whole), encoding="utf-8")
        self.execute(side, file, worker)
        results = Path(f"{out}.json")
        if not results.is_file():
            raise VersionsError(f"{side.title} ends without a result: it is no Python")
        found: dict[str, Any] = json.loads(results.read_text(encoding="utf-8"))
        return found | {"out": str(out)}

    def execute(self, side: Side, job: Path, worker: Sequence[str]) -> None:
        """Run a worker on a job in the environment of a side.

        Raises:
            VersionsError: The worker failed; the message has its last line.
        """
        python = side.python
        if python is None:
            python = str(made_environment(side.requirement, self._say))
        try:
            done = subprocess.run(
                [python, *worker, str(job)],
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
                timeout=WORKER_LIMIT_S,
                stdin=subprocess.DEVNULL,
                env=os.environ | {"OMP_NUM_THREADS": "1", "MUJOCO_GL": "disable"},
            )
        except OSError as error:
            raise VersionsError(
                f"{side.title} cannot be started as a Python: {error.strerror or error}"
            ) from error
        except subprocess.TimeoutExpired:
            raise VersionsError(
                f"{side.title} does not end on {self.title} within {WORKER_LIMIT_S:g} s"
            ) from None
        if done.returncode != 0:
            # A traceback ends with the exception, whose message may have several lines.
            *_, last = re.split(r"^(?=\w[\w.]*: )", done.stderr, flags=re.M)
            cause = " ".join(last.split()) or f"it ended with code {done.returncode}"
            if done.returncode < 0:
                cause = f"this release crashes on it ({signal.Signals(-done.returncode).name})"
            if "package:/" in cause:
                cause += ". MuJoCo knows no ROS packages: state paths beside the file"
            raise VersionsError(f"{side.title} cannot run {self.title}: {cause}")


@contextmanager
def bench(subject: str, states: Path | None = None, **options: Any) -> Iterator[Bench]:
    """Open a bench, whose files are removed at the end.

    Args:
        subject: The model, in the words of `read_subject`.
        states: File of its saved states, or None.
        options: Other arguments of `Bench`.
    """
    with TemporaryDirectory(prefix="gauge-versions-") as name:
        folder = Path(name)
        read = read_subject(subject, folder, states)
        yield Bench(
            read.file,
            folder,
            saved=read.states,
            motion=read.motion,
            title=read.title,
            **options,
        )


READING = threading.Lock()
"""NumPy parses the header of an array with `ast`, which Python 3.11 may break off in two threads at once.

Whoever reads arrays in a thread of `sides_at_once` takes it.
"""


def arrays(file: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ that a worker wrote."""
    with READING, np.load(file) as found:
        return {name: np.array(found[name]) for name in found.files}
