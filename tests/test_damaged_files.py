"""Damaged files of all readers end in an error for people or are read, in little memory and time.

    DAMAGED_FILES=10000 python -m pytest -s tests/test_damaged_files.py

A file is a valid one with damage by a seed. Each reader has a process of its own, with limits of memory and time: a
reader that exceeds them breaks its pool, and the file stays.
"""

from __future__ import annotations

import io
import json
import os
import random
import resource
import shutil
import sys
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from math import ceil
from multiprocessing import get_context
from pathlib import Path

import fork_server
import numpy as np
import pytest
from places import ROOT

from gauge_envs import load_experiment
from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.trajectory_file import read_trajectory
from gauge_envs.experiments.resolve import load_experiment_from_asset
from gauge_envs.files import MEGABYTE
from gauge_envs.references.convergence import read_convergence
from gauge_envs.references.tables import csv_header
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.runs.score_file import score_file
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.conformance.expected import read_expected
from gauge_envs.tools.conformance.matrix import read_columns
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.run import read_baseline
from gauge_envs.tools.sweep.spec import load_sweep_file
from gauge_envs.tools.usd.experiment_file import load_experiment_file
from gauge_envs.tools.usd.reader import from_usd
from gauge_envs.tools.versions.subject import check_states
from gauge_envs.tools.video.track import read_track

COUNT = int(os.environ.get("DAMAGED_FILES", "12"))
"""Damaged files of each reader."""

SEED = os.environ.get("DAMAGED_SEED", "")
"""What makes another pass of other damages."""

MOST_MEMORY = 500 * MEGABYTE
"""Memory that a reader may take beyond that of the imported package."""

MOST_S = 2.0
"""Longest processor time of one file [s]."""

ID = "SlopeSlider-2-wood"
EXTREMES = (
    *(b"nan", b"-1", b"0", b"1e999", b"-1e308", b"9" * 400, b"true", b"null", b"{}"),
    *(b"[]", b'""', b"[[[[", b"\x00", b"\xff\xfe", b"\n", b",", b'"', b"'", b"\\"),
)
"""What damage puts in the place of some bytes."""


def damaged(content: bytes, draw: random.Random) -> bytes:
    """Return a file with one to three damages."""
    data = bytearray(content)
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        start = draw.randrange(len(data) + 1)
        end = min(len(data), start + draw.choice((1, 1, 2, 4, 16, 256)))
        kind = draw.randrange(6)
        if kind == 0:
            data = data[:start]
        elif kind == 1:
            data[start:end] = draw.choice(EXTREMES)
        elif kind == 2:
            data[start:end] = draw.randbytes(end - start)
        elif kind == 3 and end > start:
            data[start] ^= 1 << draw.randrange(8)
        elif kind == 4:
            data[start:start] = data[start:end] * draw.choice((1, 1, 50))
        else:
            del data[start:end]
    return bytes(data)


# --- valid files -----------------------------------------------------------------------------------------------------


def result() -> bytes:
    return json.dumps(run_episode(RunRequest(ID)).to_dict()).encode()


def array_file(**arrays) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def samples() -> np.ndarray:
    return np.array(json.loads(result())["trajectory"]["samples"])[::6]


def trajectory_csv() -> bytes:
    stream = io.StringIO()
    np.savetxt(stream, samples(), delimiter=",")
    return stream.getvalue().encode()


def trajectory_npz() -> bytes:
    return array_file(g=samples())


def states_npz() -> bytes:
    return array_file(qpos=np.zeros((20, 7)), qvel=np.zeros((20, 6)))


def track() -> bytes:
    rows = [f"{frame},{2 * frame},{3 * frame}" for frame in range(40)]
    return "\n".join(["frame,x,y", *rows]).encode()


def matrix() -> bytes:
    document = json.loads((ROOT / "scoring" / "conformance.json").read_bytes())
    column = document["columns"][0]
    column["findings"] = dict(list(column["findings"].items())[:5])
    document["columns"] = [column]
    return json.dumps(document).encode()


USD = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
)
def PhysicsScene "scene"
{
}
def Cube "a" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"])
{
    double size = 0.1
    float physics:mass = 1
}
"""
MJCF = '<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
SETTINGS = {"backend": "mujoco", "settings": {"timestep_s": 0.002, "cone": "elliptic"}}
BASELINE = {
    "phenomenon": "slide",
    "configured": 1.0,
    "verdict": "wrong",
    "reality": {"value": 2.0, "tolerance": 0.1},
    "parts": [],
}


def read_experiment(file):
    for source in (ROOT / "examples" / "usd_experiment").iterdir():
        if source.is_file() and not (file.parent / source.name).exists():
            shutil.copy(source, file.parent)
    return load_experiment_file(file)


def text_of(*parts):
    """Returns the first whole lines of a file of the repository."""
    return lambda: ROOT.joinpath(*parts).read_bytes()[:6000].rpartition(b"\n")[0]


READERS = {
    "result.json": (result, load_result),
    "score.json": (result, score_file),
    "g.csv": (trajectory_csv, lambda file: read_trajectory(file, load_experiment(ID))),
    "g.npz": (trajectory_npz, lambda file: read_trajectory(file, load_experiment(ID))),
    "own.toml": (
        text_of("examples", "usd_experiment", "crate.toml"),
        read_experiment,
    ),
    "band.csv": (text_of("scoring", "bands", "SlopeSlider-2-wood.csv"), csv_header),
    "convergence.csv": (
        text_of("scoring", "convergence", "mujoco.csv"),
        read_convergence.__wrapped__,
    ),
    "settings.toml": (text_of("examples", "sanity", "good.toml"), configuration),
    "settings.json": (json.dumps(SETTINGS).encode, configuration),
    "settings.yaml": (lambda: b"sim:\n  dt: 0.01\n  physx: {a: 1}\n", configuration),
    "states.npz": (states_npz, check_states),
    "track.csv": (track, lambda file: read_track(file, fps=30.0)),
    "expected.toml": (lambda: b'free-fall = "a reason"\n', read_expected),
    "matrix.json": (matrix, read_columns),
    "sweep.toml": (text_of("examples", "sweep.toml"), load_sweep_file),
    "baseline.json": (json.dumps(BASELINE).encode, read_baseline),
    "scene.usda": (USD.encode, lambda file: from_usd(file, duration_s=1.0)),
    "scene.xml": (
        (assets_folder() / "mjcf" / f"{ID}.xml").read_bytes,
        lambda file: load_experiment_from_asset(ID, file),
    ),
    "robot.xml": (MJCF.encode, configuration),
}
"""A valid file and the reader of each kind."""

CHILDREN = {"scene.usda", "scene.xml", "robot.xml"}  # fmt: skip
"""Kinds that a child process reads, which takes it half a second."""


# --- damage ----------------------------------------------------------------------------------------------------------


def read_all(name: str, count: int, folder: Path) -> dict:
    """Return what a reader made of damaged files: counts of outcomes, tracebacks, seconds and memory."""
    make, read = READERS[name]
    content = make()
    file = folder / name
    draw = random.Random(SEED + name)
    found: Counter[str] = Counter()
    wrong: list[str] = []
    longest_s = 0.0
    # With room for what the process has: the sixth number is its pages of data.
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    most_bytes = pages * resource.getpagesize() + MOST_MEMORY
    resource.setrlimit(resource.RLIMIT_DATA, (most_bytes, resource.RLIM_INFINITY))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started_s = time.process_time()
    for number in range(count):
        file.write_bytes(damaged(content, draw) if number else content)
        begun_s = time.process_time()
        end_s = ceil(begun_s + MOST_S)
        resource.setrlimit(resource.RLIMIT_CPU, (end_s, resource.RLIM_INFINITY))
        try:
            read(file)
            found["read"] += 1
        except GaugeError as error:
            found["refused"] += 1
            if not number:
                wrong.append(f"the valid file is refused: {error}")
        except Exception as error:
            found["traceback"] += 1
            place = traceback.extract_tb(error.__traceback__)[-1]
            wrong.append(f"{number}: {error!r} {place.filename}:{place.lineno}")
        longest_s = max(longest_s, time.process_time() - begun_s)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        **found,
        "wrong": wrong[:5],
        "cpu_s": time.process_time() - started_s,
        "longest_s": longest_s,
        "memory": 1024 * (after - before),
    }


@pytest.mark.skipif(sys.platform != "linux", reason="a fork of Linux has the limits")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_in_words(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    count = max(2, COUNT // 50) if name in CHILDREN else COUNT
    fork_server.start()
    with ProcessPoolExecutor(1, get_context("fork")) as pool:
        found = pool.submit(read_all, name, count, tmp_path).result()
    print(name, found)
    assert not found["wrong"]
    assert found["longest_s"] < MOST_S
    assert found["memory"] < MOST_MEMORY
