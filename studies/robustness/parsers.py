"""The parsers of the package, each with valid files that an attack damages."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import damage
import gymnasium
import mujoco
import numpy as np
from killed_imports import write_data_set
from pxr import Sdf

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.cli.arguments import (
    parsed_jitter,
    parsed_limits,
    parsed_settings,
    quantities,
    split_details,
)
from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.trajectory_file import read_trajectory, stated_origin
from gauge_envs.experiments.resolve import load_experiment_from_asset
from gauge_envs.experiments.task_files import load_task
from gauge_envs.experiments.variants import task_path, variants
from gauge_envs.files import data_folder
from gauge_envs.pages.document import as_markdown
from gauge_envs.references.bands import BandSidecar, read_band
from gauge_envs.references.imported import load_imported
from gauge_envs.references.tables import read_toml, scoring_folder
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.replay import load_or_replay, replay_path
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.scene.jitter import Jitter
from gauge_envs.tools.compare import compare, comparison_document
from gauge_envs.tools.conformance import checks
from gauge_envs.tools.conformance.matrix import (
    MatrixColumn,
    read_columns,
    run_column,
    write_columns,
)
from gauge_envs.tools.conformance.words import matrix_document
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials
from gauge_envs.tools.dataset.observation import driver_tracks, trial_trajectory
from gauge_envs.tools.dataset.trial import TrialError, parse_trial
from gauge_envs.tools.film.rerun_file import write_rerun
from gauge_envs.tools.leaderboard import check_leaderboard
from gauge_envs.tools.leaderboard.submission import Fault, read_statement
from gauge_envs.tools.leaderboard.words import leaderboard_document
from gauge_envs.tools.recipes import Aim, engine_names, engine_settings
from gauge_envs.tools.recipes.command import NUMBERS
from gauge_envs.tools.recipes.explain import parsed_contact
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.gauge_probe import document as probe_document
from gauge_envs.tools.sanity.run import read_baseline
from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec
from gauge_envs.tools.transfer.policies.load import load_policy
from gauge_envs.tools.transfer.policies.sb3 import load_sb3
from gauge_envs.tools.usd.experiment_file import load_experiment_file
from gauge_envs.tools.usd.reader import from_usd
from gauge_envs.tools.video import FileFrames, read_camera, read_track

NAME = "SlopeSlider-2-wood"
EXAMPLES = Path(__file__).parents[2] / "examples" / "sanity"
CONTROL = "GAUGE/Turntable-Limit-wood"
"""Task whose policies are read."""


class RefusedError(Exception):
    """A fault that a parser returns, where others raise an error."""


EXPECTED = (GaugeError, TrialError, RefusedError)
"""Errors with which a parser refuses a file."""


@dataclass(frozen=True)
class Parser:
    """A parser under attack.

    Attributes:
        suffix: Suffix of the damaged file.
        seeds: Contents that are valid; none where what writes them is not installed.
        read: Reads a file; an error of gauge-envs is the expected outcome.
        damage: Damages a content.
        share: Number of files relative to other parsers; slow parsers get fewer.
    """

    suffix: str
    seeds: list[bytes]
    read: Callable[[Path], object]
    damage: damage.Damage = damage.in_text
    share: float = 1.0


# --- valid files -----------------------------------------------------------------------------------------------------

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

GYM = """
sim: {dt: 0.005, substeps: 2, gravity: [0, 0, -9.81], physx: &p {solver_type: 1, num_position_iterations: 4,
  num_velocity_iterations: 0, contact_offset: 0.01, bounce_threshold_velocity: 0.5}}
other: *p
plane: {static_friction: 1.0, dynamic_friction: "${ground.friction}", restitution: 0.0}
ground: {friction: 1.0}
domain_rand: {randomize_friction: true, friction_range: !!python/tuple [0.5, 1.25]}
"""
"""A configuration in the style of IsaacGym, with aliases, tags and a reference."""

LAB = """
sim:
  dt: 0.005
  gravity: !!python/tuple [0.0, 0.0, -9.81]
  physx: {solver_type: 1, max_position_iteration_count: 255, min_position_iteration_count: 1,
    bounce_threshold_velocity: 0.5, friction_offset_threshold: 0.04, friction_correlation_distance: 0.025}
  physics_material: {static_friction: 1.0, dynamic_friction: 1.0, restitution: 0.0, friction_combine_mode: multiply,
    restitution_combine_mode: multiply}
decimation: 4
"""

GENESIS = json.dumps(
    {
        "sim": {
            "dt": 0.01,
            "substeps": 2,
            "gravity": [0.0, 0.0, -9.81],
            "floor_height": 0.0,
            "requires_grad": False,
        },
        "rigid": {
            "dt": None,
            "integrator": 3,
            "constraint_solver": 1,
            "iterations": 50,
            "tolerance": 1e-6,
            "ls_iterations": 50,
            "constraint_timeconst": 0.01,
            "enable_collision": True,
            "use_gjk_collision": False,
        },
    }
)

SETTINGS = """
backend = "mujoco"
preset = "contact"
[settings]
timestep_s = 0.002
cone = "elliptic"
impratio = 100.0
contact_solref = [0.02, 1.0]
"""

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
settings = {timestep_s = 0.001}
[left_out]
"C*" = "not supported"
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
[points]
px = [[400, 600], [900, 600], [800, 300], [500, 300]]
m = [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]
sigma_px = 0.5
sigma_m = 0.001
""",
)

TRACK = "frame,x,y,confidence\n" + "".join(
    f"{row},{400 + row},{100 + row * row},0.9\n" for row in range(30)
)

NUMBER_TEXTS = (
    "1mm,0.5deg",
    "3600s,4GB",
    "friction=0.4 restitution=0.6 mass_kg=0.5 timestep_s=0.002",
    "stiffness_n_per_m=20000 damping_n_s_per_m=5 mass_kg=2 timestep_s=0.01",
    "solref=0.02 1 solimp=0.9 0.95 0.001",
    "timestep_s=0.0005555555555555556 solver=Newton iterations=20",
)
"""Numbers of the command line: jitter, limits, recipes, contacts, settings."""


def sb3_policies(size: int) -> list[bytes]:
    """Return a file of Stable-Baselines3 for one action; none without PyTorch."""
    if find_spec("torch") is None:
        return []
    import torch

    hidden, last = torch.nn.Linear(size, 4), torch.nn.Linear(4, 1)
    named = {"mlp_extractor.policy_net.0.": hidden, "action_net.": last}
    weights, file = io.BytesIO(), io.BytesIO()
    torch.save(
        {
            prefix + key: one
            for prefix, layer in named.items()
            for key, one in layer.state_dict().items()
        },
        weights,
    )
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(
            "data",
            json.dumps(
                {"policy_class": {"__module__": "stable_baselines3.common.policies"}}
            ),
        )
        archive.writestr("policy.pth", weights.getvalue())
    return [file.getvalue()]


def onnx_policies(size: int) -> list[bytes]:
    """Return a network that multiplies an observation by a column, in the wire format of ONNX; none without runtime."""
    if find_spec("onnxruntime") is None:
        return []

    def field(number: int, value: int | bytes | str) -> bytes:
        if isinstance(value, int):
            return bytes((number << 3, value))
        content = value.encode() if isinstance(value, str) else value
        return bytes((number << 3 | 2, len(content))) + content

    def port(name: str, *sizes: int) -> bytes:
        shape = b"".join(field(1, field(1, one)) for one in sizes)
        return field(1, name) + field(2, field(1, field(1, 1) + field(2, shape)))

    node = field(1, "o") + field(1, "w") + field(2, "a") + field(4, "MatMul")
    weights = field(1, size) + field(1, 1) + field(2, 1) + field(8, "w")
    weights += field(9, np.full(size, 0.1, dtype="<f4").tobytes())
    graph = field(1, node) + field(2, "policy") + field(5, weights)
    graph += field(11, port("o", 1, size)) + field(12, port("a", 1, 1))
    return [
        field(1, 8)
        + bytes((7 << 3 | 2, len(graph) & 127 | 128, len(graph) >> 7))
        + graph
        + field(8, field(2, 17))
    ]


def videos(folder: Path) -> list[bytes]:
    """Return short videos in containers that OpenCV writes."""
    found = []
    for name, code in (("a.mp4", "mp4v"), ("a.avi", "MJPG")):
        writer = cv2.VideoWriter(
            str(folder / name), cv2.VideoWriter_fourcc(*code), 30.0, (64, 48)
        )
        for number in range(12):
            writer.write(np.full((48, 64, 3), 20 * number, dtype=np.uint8))
        writer.release()
        found.append((folder / name).read_bytes())
    return found


# --- parsers ---------------------------------------------------------------------------------------------------------


def parsers(folder: Path) -> Mapping[str, Parser]:
    """Return the parsers by name; files that they need beside the damaged one are in a folder."""
    return {
        **_of_trajectories(folder),
        **_of_experiments(folder),
        **_of_results(folder),
        **_of_imports(folder),
        **_of_training(folder),
        **_of_policies(),
        **_of_videos(folder),
        "numbers": Parser(
            ".words", [text.encode() for text in NUMBER_TEXTS], read_numbers
        ),
    }


def read_numbers(file: Path) -> None:
    """Read a text as each kind of number that the command line takes; it is refused if all refuse it."""
    text = file.read_bytes().decode(errors="replace")
    engines = [engine_settings(name) for name in engine_names()]

    def aim() -> None:
        _, numbers = split_details(text.split(), **dict.fromkeys(NUMBERS, float))
        Aim(**({"friction": 0.5, "mass_kg": 1.0, "timestep_s": 0.002} | numbers))

    def settings() -> None:
        scene = load_experiment(NAME).scene
        backend("mujoco").resolved_settings(scene, parsed_settings(text.split()))

    reads: list[Callable[[], object]] = [
        lambda: Jitter(**parsed_jitter(text)),
        lambda: parsed_limits(text),
        lambda: quantities("size", text, x=1.0),
        aim,
        settings,
        *(
            (lambda engine=engine: parsed_contact(engine, text, 0.002))
            for engine in engines
        ),
    ]
    refused = []
    for read in reads:
        try:
            read()
        except EXPECTED as error:
            refused.append(error)
    if len(refused) == len(reads):
        raise refused[0]


def _of_trajectories(folder: Path) -> dict[str, Parser]:
    experiment = load_experiment(NAME)
    frames, steps = (
        experiment.frame_count,
        np.linspace(0.0, 40.0, experiment.frame_count),
    )
    start_mm = 1e3 * np.asarray(experiment.scene.body("cube").pose.position_m)
    columns = {
        axis: (start_mm[index] + steps).round(3).tolist()
        for index, axis in enumerate("xyz")
    }
    turned = {
        axis: [0.0 if axis != "qw" else 1.0] * frames
        for axis in ("qx", "qy", "qz", "qw")
    }
    trial = json.dumps(
        {"FPS": 30, "translation unit": "mm", "cube": columns | turned}
    ).encode()
    path = np.column_stack([columns[axis] for axis in "xyz"])
    np.savez(folder / "g.npz", g=path, time_s=np.arange(frames) / 30.0)
    np.savez_compressed(folder / "small.npz", g=path)
    table = "\n".join(
        ["cube.x,cube.y,cube.z", *(",".join(map(str, row)) for row in path.tolist())]
    )
    arrays = [(folder / name).read_bytes() for name in ("g.npz", "small.npz")]

    def trial_read(file: Path) -> None:
        found = parse_trial(file.read_bytes())
        trial_trajectory(found, experiment)
        driver_tracks(found, experiment)

    def trajectory_read(file: Path) -> None:
        stated_origin(file)
        read_trajectory(file, experiment)

    return {
        "trial": Parser(".json", [trial], trial_read, damage.in_json),
        "csv": Parser(".csv", [table.encode()], trajectory_read),
        "npz": Parser(".npz", arrays, trajectory_read, damage.in_archive),
        "json": Parser(
            ".json",
            [json.dumps({"id": NAME, "g": path.tolist()}).encode()],
            trajectory_read,
            damage.in_json,
        ),
    }


def _of_experiments(folder: Path) -> dict[str, Parser]:
    layer = data_folder("assets") / "usd" / f"{NAME}.usda"
    (folder / "scene.usda").write_bytes(layer.read_bytes())
    Sdf.Layer.FindOrOpen(str(layer)).Export(str(folder / "scene.usdc"))
    band = scoring_folder("bands") / f"{NAME}.csv"
    sidecar = read_toml(band.with_suffix(".toml"), BandSidecar)
    own = f"""
name = "crate"
title = "A crate on a slope"
usd = "scene.usda"
frames = {load_experiment(NAME).frame_count}
recorded = ["cube"]
score = {{ observable = "position" }}
[provenance]
all = "nominal: a seed"
"""
    model = (data_folder("assets") / "mjcf" / f"{NAME}.xml").read_bytes()
    return {
        "task": Parser(
            ".toml", [task_path("SlopeSlider").read_bytes()], load_task, share=0.3
        ),
        "experiment": Parser(".toml", [own.encode()], load_experiment_file, share=0.1),
        "band": Parser(
            ".csv", [band.read_bytes()], lambda file: read_band(file, sidecar, file)
        ),
        "usda": Parser(
            ".usda",
            [layer.read_bytes()],
            lambda file: from_usd(file, duration_s=1.0),
            share=0.03,
        ),
        "usdc": Parser(
            ".usdc",
            [(folder / "scene.usdc").read_bytes()],
            lambda file: from_usd(file, duration_s=1.0),
            damage.in_bytes,
            0.004,
        ),
        "mjcf": Parser(
            ".xml",
            [model],
            lambda file: load_experiment_from_asset(NAME, file),
            share=0.004,
        ),
    }


def _of_results(folder: Path) -> dict[str, Parser]:
    result_file = folder / "seed-result.json"
    write_result(run_episode(RunRequest(NAME, backend="mujoco")), result_file)
    result = load_result(result_file)
    load_or_replay(result, result_file)
    column = MatrixColumn(backend="mujoco", name="PGS", settings={"solver": "PGS"})
    list(run_column(column, ["free-fall", "foam-start", "slide-plane"], None))
    matrix = write_columns([column], folder / "column.json").read_bytes()

    def replay_read(file: Path) -> None:
        """Read a damaged replay beside a result that is whole: it counts, or the episode runs again."""
        stored = replay_path(result_file)
        stored.write_bytes(file.read_bytes())
        found = load_or_replay(result, result_file)
        assert found.bodies == ("cube",), found.bodies

    def sweep_read(file: Path) -> None:
        sweep_spec(load_sweep_file(file)).episode_count()

    def rerun_read(file: Path) -> None:
        write_rerun(load_result(file), folder / "a.rrd")

    board = folder / "board"
    place = board / "mujoco" / result.versions["mujoco"] / "default"
    (place / "results").mkdir(parents=True)
    left_out = "".join(
        f'"{one.name}" = "not run"\n' for one in variants() if one.id != result.id
    )
    stated = (
        STATEMENT.replace("rapier3d", "mujoco")
        .replace("rapier", "mujoco")
        .partition("settings =")[0]
    )
    stated = stated.replace("0.36.1", result.versions["mujoco"])
    (place / "submission.toml").write_text(f"{stated}[left_out]\n{left_out}")

    def submission_read(file: Path) -> None:
        """Read a damaged result of a submission: the check lists what is wrong."""
        (place / "results" / result_file_name(result)).write_bytes(file.read_bytes())
        found = check_leaderboard(board)
        as_markdown(leaderboard_document(found))
        if found.all_faults:
            raise RefusedError(str(found.all_faults[0]))

    def statement_read(file: Path) -> None:
        found = read_statement(file, file.name)
        if isinstance(found, Fault):
            raise RefusedError(str(found))

    replayed = replay_path(result_file).read_bytes()
    results, documents = [result_file.read_bytes()], damage.in_json
    return {
        "result": Parser(
            ".json",
            results,
            lambda file: as_markdown(comparison_document(compare([load_result(file)]))),
            documents,
            0.2,
        ),
        "rerun": Parser(
            ".json", results if find_spec("rerun") else [], rerun_read, documents, 0.02
        ),
        "replay": Parser(".npz", [replayed], replay_read, damage.in_archive, 0.02),
        "submission": Parser(".json", results, submission_read, documents, 0.01),
        "statement": Parser(".toml", [STATEMENT.encode()], statement_read),
        "sweep": Parser(".toml", [SWEEP.encode()], sweep_read),
        "matrix": Parser(
            ".json",
            [matrix],
            lambda file: as_markdown(
                matrix_document(read_columns(file), checks(["free-fall"]))
            ),
            documents,
            0.3,
        ),
    }


def _of_imports(folder: Path) -> dict[str, Parser]:
    """Return the parser of an imported variant; the data set is that of `killed_imports.py`."""
    write_data_set(folder / "published", 0.0)
    os.environ["GAUGE_DATA_DIR"] = str(folder / "store")
    list(import_trials(find_trials(folder / "published")))
    record = user_data_folder() / "trials" / f"{NAME}.json"

    def read(file: Path) -> None:
        record.write_bytes(file.read_bytes())
        load_imported(NAME)

    return {"imported": Parser(".json", [record.read_bytes()], read, damage.in_json)}


def _of_training(folder: Path) -> dict[str, Parser]:
    probe = json.dumps(probe_document(mujoco.MjModel.from_xml_string(ROBOT))).encode()
    rows = [
        {
            "phenomenon": "creep-wood",
            "verdict": "wrong",
            "configured": 0.3,
            "reality": {"value": 0, "tolerance": 1},
        }
    ]
    large = [file.read_bytes() for file in sorted(EXAMPLES.glob("g1_*.yaml"))]
    return {
        "isaac_lab": Parser(".yaml", [LAB.encode()], configuration, share=0.3),
        "g1": Parser(".yaml", large, configuration, share=0.02),
        "isaac_gym": Parser(".yaml", [GYM.encode()], configuration, share=0.3),
        "genesis": Parser(
            ".json", [GENESIS.encode()], configuration, damage.in_json, 0.3
        ),
        "settings": Parser(".toml", [SETTINGS.encode()], configuration),
        "robot": Parser(".xml", [ROBOT.encode()], configuration, share=0.004),
        "probe": Parser(
            ".gaugeprobe.json", [probe], configuration, damage.in_json, 0.1
        ),
        "baseline": Parser(
            ".json",
            [b"\n".join(json.dumps(row).encode() for row in rows)],
            read_baseline,
            damage.in_json,
        ),
    }


def _of_policies() -> dict[str, Parser]:
    env = gymnasium.make(CONTROL).unwrapped
    assert isinstance(env, ControlEnv)
    (size,) = env.observation_space.shape or (0,)
    return {
        "sb3": Parser(
            ".zip",
            sb3_policies(size),
            lambda file: load_sb3(file, observation_size=size, action_size=1),
            damage.in_archive,
        ),
        "onnx": Parser(
            ".onnx",
            onnx_policies(size),
            lambda file: load_policy(str(file), env),
            damage.in_bytes,
            0.004,
        ),
    }


def _of_videos(folder: Path) -> dict[str, Parser]:
    def video_read(file: Path) -> None:
        for _ in FileFrames(file).native():
            pass

    return {
        "camera": Parser(".toml", [text.encode() for text in CAMERAS], read_camera),
        "track": Parser(
            ".csv", [TRACK.encode()], lambda file: read_track(file, fps=30.0)
        ),
        "video": Parser(".mp4", videos(folder), video_read, damage.in_bytes, 0.3),
    }
