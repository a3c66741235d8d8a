"""Attack every parser with damaged files: each must end in an error for people, in little time and memory.

A file is damaged at random with a fixed seed: bytes change, parts are cut, repeated or exchanged, and hostile tokens
are put in. An error that is no error of gauge-envs, a call of more than 10 s, or a peak of memory above 1 GB is a
failure. Examples:

    python studies/robustness/attack.py
    python studies/robustness/attack.py --count 1000 --only usda --seed 3
"""

from __future__ import annotations

import argparse
import io
import json
import pickle
import random
import resource
import sqlite3
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from pxr import Sdf

from gauge_envs import load_experiment
from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.trajectory_file import read_trajectory, stated_origin
from gauge_envs.experiments.resolve import load_experiment_from_asset
from gauge_envs.experiments.task_files import load_task
from gauge_envs.experiments.user_file import load_experiment_file
from gauge_envs.experiments.variants import task_path
from gauge_envs.files import data_folder
from gauge_envs.pages.document import as_markdown
from gauge_envs.references.bands import BandSidecar, read_band
from gauge_envs.references.tables import read_toml, scoring_folder
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, write_result
from gauge_envs.scene.usd.reader import from_usd
from gauge_envs.tools.compare import compare, comparison_document
from gauge_envs.tools.conformance import checks
from gauge_envs.tools.conformance.matrix import MatrixColumn, read_columns, run_column, write_columns
from gauge_envs.tools.conformance.words import matrix_document
from gauge_envs.tools.dataset.observation import driver_tracks, trial_trajectory
from gauge_envs.tools.dataset.trial import TrialError, parse_trial
from gauge_envs.tools.leaderboard.submission import read_statement
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.probe.program import document as probe_document
from gauge_envs.tools.sanity.stacks.documents import read_yaml
from gauge_envs.tools.sanity.stacks.isaac_gym import isaac_gym_configuration
from gauge_envs.tools.sanity.stacks.isaac_lab import isaac_lab_configuration
from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec
from gauge_envs.tools.sweep.store import SweepFolder, update_store
from gauge_envs.tools.transfer.policies.load import read_normalization
from gauge_envs.tools.transfer.policies.sb3 import load_sb3
from gauge_envs.tools.video import read_camera, read_track

MOST_S = 10.0
MOST_MEMORY_MB = 1000.0

NAME = "SlopeSlider-2-wood"

ROBOT = """
<mujoco>
  <asset><mesh name="foot" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/></asset>
  <worldbody><geom name="floor" type="plane" size="1 1 1"/>
    <body name="a" pos="0 0 1"><freejoint/><geom type="mesh" mesh="foot"/>
      <body name="b"><joint range="-1 1" limited="true"/><geom name="b" type="capsule" size=".1 .1"/></body></body>
  </worldbody>
  <contact><pair geom1="floor" geom2="b"/><exclude body1="a" body2="b"/></contact>
</mujoco>
"""
"""Seed of probe files."""
EXAMPLES = Path(__file__).parents[2] / "examples" / "sanity"

TOKENS = (
    *(b"nan", b"-inf", b"1e999", b"-1", b"0", b"1e-320", b"0x" + b"f" * 9000, b"9" * 10_000, b"1000000000", b"null"),
    *(
        b"!!python/object/apply:os.abort []",
        b"!!python/tuple ",
        b"&a [*a]",
        b"*p",
        b"<<: *p",
        b"${sim.dt}",
        b"\t",
        b": ",
    ),
    *(b"true", b'"', b"'", b"{", b"}", b"[", b"]", b"[" * 5000, b'{"a":' * 3000, b"a." * 3000, b"\x00", b"\xff\xfe"),
    *(
        b"\x1b[2J",
        b"\n# heading\n",
        b"$\\frac{$",
        b":smile:",
        b"~nosuchuser/x",
        b"../../../etc/passwd",
        b",",
        b"=",
        b"\r",
    ),
)


GYM = """
sim: {dt: 0.005, substeps: 2, gravity: [0, 0, -9.81], physx: &p {solver_type: 1, num_position_iterations: 4,
  num_velocity_iterations: 0, contact_offset: 0.01, bounce_threshold_velocity: 0.5}}
other: *p
plane: {static_friction: 1.0, dynamic_friction: "${ground.friction}", restitution: 0.0}
ground: {friction: 1.0}
domain_rand: {randomize_friction: true, friction_range: !!python/tuple [0.5, 1.25]}
"""
"""A configuration in the style of IsaacGym, with aliases, tags and a reference."""


SWEEP = """
backends = ["mujoco"]
variants = ["SlopeSlider-2-*", "BouncingBall-rubber"]
parameters = ["calibrated", { "cube.friction" = 0.3 }]
repeats = 4
seed = 7
jitter = { position_m = 0.001, angle_rad = 0.01 }
[settings]
timestep_s = [0.0005555555555555556, 0.0002777777777777778]
[settings.mujoco]
iterations = [10, 50]
"""

STATEMENT = """
format = 1
engine = "rapier"
package = "rapier3d"
version = "0.36.1"
configuration = "default"
submitter = "A vendor"
url = "https://example.org"
settings = {}
[left_out]
"C*" = "no soft bodies"
"""

CAMERAS = (
    """
size_px = [1280, 720]
[points]
px = [[400, 600], [900, 600], [800, 300], [500, 300]]
m = [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]
sigma_px = 0.5
sigma_m = 0.001
[motion]
pivot_m = [0.0, 0.15]
pivot_sigma_m = 0.002
length_m = 0.138
""",
    """
size_px = [1280, 720]
[lens]
matrix = [[765.7, 0, 657.1], [0, 765.7, 346.7], [0, 0, 1]]
distortion = [0.1006, -0.0986]
focal_sigma = 0.001
[pose]
rvec = [0.846161, 1.8035, -1.530041]
tvec = [-0.199238, 0.162863, 1.531948]
position_sigma_m = 0.002
rotation_sigma_rad = 0.001
[plane]
point_m = [0.41, 0.41, 0.214]
normal = [0, 0, 1]
up = [0, 1, 0]
sigma_m = 0.002
""",
)

TRACK = "frame,x,y,confidence\n" + "".join(f"{row},{400 + row},{100 + row * row},0.9\n" for row in range(30))


class VecNormalize:
    """Stand-in of the class in files of `VecNormalize.save`."""


def statistics() -> bytes:
    """Return a file of `VecNormalize.save` for an observation of size 5."""
    saved, saved.obs_rms = VecNormalize(), VecNormalize()
    saved.obs_rms.mean, saved.obs_rms.var = np.zeros(5), np.ones(5)
    saved.clip_obs, saved.epsilon = 10.0, 1e-8
    return pickle.dumps(saved)


def sb3_policies() -> list[bytes]:
    """Return a file of Stable-Baselines3 for 5 observations and 1 action; none without PyTorch."""
    try:
        import torch
    except ImportError:
        return []
    hidden, last = torch.nn.Linear(5, 4), torch.nn.Linear(4, 1)
    named = {"mlp_extractor.policy_net.0.": hidden, "action_net.": last}
    weights, file = io.BytesIO(), io.BytesIO()
    torch.save(
        {prefix + key: one for prefix, layer in named.items() for key, one in layer.state_dict().items()}, weights
    )
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {"__module__": "stable_baselines3.common.policies"}}))
        archive.writestr("policy.pth", weights.getvalue())
    return [file.getvalue()]


@dataclass(frozen=True)
class Target:
    """A parser under attack.

    Attributes:
        suffix: Suffix of the damaged file.
        seeds: Contents that are valid.
        read: Reads a file; an error of gauge-envs is the expected outcome.
        share: Number of files relative to other parsers; slow parsers get fewer.
    """

    suffix: str
    seeds: list[bytes]
    read: Callable[[Path], object]
    share: float = 1.0


def mutated(content: bytes, chance: random.Random) -> bytes:
    """Return a damaged content."""
    values = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 8))):
        size = len(values)
        place, other = chance.randrange(size + 1), chance.randrange(size + 1)
        length = chance.choice((1, 2, 4, 16, 64, 1024))
        kind = chance.randrange(7)
        if kind == 0 and place < size:
            values[place] = chance.randrange(256)
        elif kind == 1:
            del values[place : place + length]
        elif kind == 2:
            values[place:place] = values[other : other + length] * chance.choice((1, 2, 50))
        elif kind == 3:
            values[place : place + length] = values[other : other + length]
        elif kind == 4:
            values[place:place] = chance.choice(TOKENS)
        elif kind == 5:
            values[place : place + length] = chance.choice(TOKENS)
        elif chance.random() < 0.2:
            del values[place:]
    return bytes(values)


def targets(folder: Path) -> dict[str, Target]:
    """Return the parsers by name."""
    experiment = load_experiment(NAME)
    frames, steps = experiment.frame_count, np.linspace(0.0, 40.0, experiment.frame_count)
    start_mm = 1e3 * np.asarray(experiment.scene.body("cube").pose.position_m)
    columns = {axis: (start_mm[index] + steps).round(3).tolist() for index, axis in enumerate("xyz")}
    turned = {axis: [0.0 if axis != "qw" else 1.0] * frames for axis in ("qx", "qy", "qz", "qw")}
    trial = json.dumps({"FPS": 30, "translation unit": "mm", "cube": columns | turned}).encode()
    path = np.column_stack([columns[axis] for axis in "xyz"])
    result_file = folder / "seed-result.json"
    write_result(run_episode(RunRequest(NAME, backend="mujoco")), result_file)
    np.savez(folder / "g.npz", g=path, time_s=np.arange(frames) / 30.0)
    np.savez_compressed(folder / "small.npz", g=path)
    table = "\n".join(["cube.x,cube.y,cube.z", *(",".join(map(str, row)) for row in path.tolist())])
    band = scoring_folder("bands") / f"{NAME}.csv"
    sidecar = read_toml(band.with_suffix(".toml"), BandSidecar)
    layer = data_folder("assets") / "usd" / f"{NAME}.usda"
    (folder / "scene.usda").write_bytes(layer.read_bytes())
    own = "\n".join(
        [
            'name = "crate"',
            'title = "A crate on a slope"',
            'usd = "scene.usda"',
            f"frames = {frames}",
            'recorded = ["cube"]',
            'score = { observable = "position" }',
            "[provenance]",
            'all = "nominal: a seed"',
        ]
    )
    probe = json.dumps(probe_document(mujoco.MjModel.from_xml_string(ROBOT))).encode()
    Sdf.Layer.FindOrOpen(str(layer)).Export(str(folder / "scene.usdc"))

    def trial_read(file: Path) -> None:
        found = parse_trial(file.read_bytes())
        trial_trajectory(found, experiment)
        driver_tracks(found, experiment)

    def trajectory_read(file: Path) -> None:
        stated_origin(file)
        read_trajectory(file, experiment)

    column = MatrixColumn(backend="mujoco", name="PGS", settings={"solver": "PGS"})
    list(run_column(column, ["free-fall", "foam-start", "slide-plane"], None))
    matrix = write_columns([column], folder / "column.json").read_bytes()
    swept = SweepFolder(folder / "swept")
    swept.create()
    swept.write(load_result(result_file), "a.json")
    update_store(swept.path)

    def store_read(file: Path) -> None:
        """Read a damaged store beside a result file that is whole: its row must be there."""
        swept.store_path.write_bytes(file.read_bytes())
        try:
            with closing(sqlite3.connect(update_store(swept.path))) as store:
                rows = store.execute("SELECT id, outcome FROM results").fetchall()
        finally:
            for left in swept.path.glob("sweep.sqlite*"):
                left.unlink()
        assert rows == [(f"GAUGE/{NAME}", "finished")], rows

    def compared(file: Path) -> None:
        as_markdown(comparison_document(compare([load_result(file)])))

    def sweep_read(file: Path) -> None:
        spec = sweep_spec(load_sweep_file(file))
        spec.episode_count()

    return {
        "sweep": Target(".toml", [SWEEP.encode()], sweep_read, 1.0),
        "store": Target(".sqlite", [swept.store_path.read_bytes()], store_read, 0.1),
        "matrix": Target(
            ".json", [matrix], lambda file: as_markdown(matrix_document(read_columns(file), checks(["free-fall"]))), 1.0
        ),
        "statement": Target(".toml", [STATEMENT.encode()], lambda file: read_statement(file, file.name), 1.0),
        "camera": Target(".toml", [text.encode() for text in CAMERAS], read_camera, 1.0),
        "track": Target(".csv", [TRACK.encode()], lambda file: read_track(file, fps=30.0), 1.0),
        "statistics": Target(".pkl", [statistics()], lambda file: read_normalization(file, observation_size=5), 5.0),
        "policy": Target(".zip", sb3_policies(), lambda file: load_sb3(file, observation_size=5, action_size=1), 0.5),
        "trial": Target(".json", [trial], trial_read, 2.0),
        "csv": Target(".csv", [table.encode()], trajectory_read, 2.0),
        "npz": Target(".npz", [(folder / name).read_bytes() for name in ("g.npz", "small.npz")], trajectory_read, 2.0),
        "json": Target(".json", [json.dumps({"id": NAME, "g": path.tolist()}).encode()], trajectory_read, 2.0),
        "result": Target(".json", [result_file.read_bytes()], compared, 0.5),
        "band": Target(".csv", [band.read_bytes()], lambda file: read_band(file, sidecar, file), 1.0),
        "task": Target(".toml", [task_path("SlopeSlider").read_bytes()], load_task, 0.2),
        "experiment": Target(".toml", [own.encode()], load_experiment_file, 0.5),
        "usda": Target(".usda", [layer.read_bytes()], lambda file: from_usd(file, duration_s=1.0), 0.5),
        "usdc": Target(
            ".usdc", [(folder / "scene.usdc").read_bytes()], lambda file: from_usd(file, duration_s=1.0), 0.01
        ),
        "probe": Target(".gaugeprobe.json", [probe], configuration, 0.5),
        "isaac_lab": Target(
            ".yaml",
            [file.read_bytes() for file in sorted(EXAMPLES.glob("g1_*.yaml"))],
            lambda file: isaac_lab_configuration(read_yaml(file), name=file.name, source=file.name),
            0.2,
        ),
        "isaac_gym": Target(
            ".yaml",
            [GYM.encode()],
            lambda file: isaac_gym_configuration(read_yaml(file), name=file.name, source=file.name),
            0.2,
        ),
        "mjcf": Target(
            ".xml",
            [(data_folder("assets") / "mjcf" / f"{NAME}.xml").read_bytes()],
            lambda file: load_experiment_from_asset(NAME, file),
            0.01,
        ),
    }


def main() -> None:
    """Attack the parsers, print a line for each, and exit with 1 after a failure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000, help="files for a parser of share 1")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", action="append", help="parser to attack; repeatable; all by default")
    parser.add_argument("--keep", type=Path, help="folder for the files that fail")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        known = targets(Path(folder))
        failures = sum(attack(name, known[name], given, Path(folder)) for name in given.only or known)
    raise SystemExit(failures > 0)


def attack(name: str, target: Target, given: argparse.Namespace, folder: Path) -> int:
    """Attack one parser and return the number of failures."""
    if not target.seeds:
        print(f"{name:10} left out: what writes its files is not installed")
        return 0
    chance = random.Random(f"{name} {given.seed}")
    count = max(1, round(given.count * target.share))
    failures, refused, slowest_s = 0, 0, 0.0
    for index in range(count):
        # A new name for each file, as readers cache files by their path.
        file = folder / f"{name}-{index}{target.suffix}"
        file.write_bytes(mutated(chance.choice(target.seeds), chance))
        start = time.perf_counter()
        try:
            with _quiet():
                target.read(file)
        except (GaugeError, TrialError):
            refused += 1
        except Exception:
            failures += 1
            print(f"{name} {index}: {traceback.format_exc(limit=-3)}", file=sys.stderr)
            if given.keep:
                (given.keep / file.name).write_bytes(file.read_bytes())
        slowest_s = max(slowest_s, time.perf_counter() - start)
        file.unlink()
    peak_mb = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1e3
    print(
        f"{name:10} {count:7} files, {refused:7} refused, {failures} tracebacks, slowest {slowest_s:.2f} s, "
        f"peak {peak_mb:.0f} MB",
        flush=True,
    )
    return failures + (slowest_s > MOST_S) + (peak_mb > MOST_MEMORY_MB)


@contextmanager
def _quiet() -> Iterator[None]:
    """Leave out the warnings that libraries print through Python."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


if __name__ == "__main__":
    main()
