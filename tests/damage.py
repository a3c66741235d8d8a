"""Damage files at random, and read them as commands do; a reader may fail only with a sentence that names the file."""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import tempfile
import traceback
import warnings
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
from dataset_writer import body_asset, trial_content, write_trial
from places import ROOT

from gauge_envs import load_experiment, reference_band
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import GaugeError
from gauge_envs.experiments.task_reader import load_task
from gauge_envs.formats.usd.reader import from_usd
from gauge_envs.references.band import load_band
from gauge_envs.references.imported import ImportFacts, load_imported, write_imported
from gauge_envs.references.user_data import imported_file
from gauge_envs.runs.configuration import group_by_configuration
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.runs.score_file import score_file
from gauge_envs.tools.conformance.expectations import read_known_failures
from gauge_envs.tools.conformance.results import read_columns
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials
from gauge_envs.tools.replay.log import read_map
from gauge_envs.tools.replay.model import load_model
from gauge_envs.tools.replay.readers import read_log
from gauge_envs.tools.run.folder import earlier_outcomes
from gauge_envs.tools.run.report import summary_document
from gauge_envs.tools.run.spec import load_sweep_file
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.readers import gauge_probe
from gauge_envs.tools.video.frames import FileFrames
from gauge_envs.tools.video.track import read_track

ID = "SlopeSlider-2-wood"
OWN = ROOT / "examples" / "own_experiment"

WRONG = (
    *(None, True, 0, -1, 1.5, 10**40, 1e308, "", "text", "\ud800", "a\0b", [], {}),
    *([[]], [None], [1e999], {"a": {}}, float("nan"), float("inf"), "1", [[1.0, 2.0]]),
)
"""Values of a wrong type, size or kind, in JSON."""

WORDS = (
    *("nan", "inf", "-1", "0", "1e308", "1e999", "9" * 400, "null", "true", "''", ""),
    *(
        "[]",
        "{}",
        "text",
        "\0",
        "\u00e9",
        "-0.0",
        "1e-320",
        "0x10",
        "[[",
        "}",
        '"',
        "<",
    ),
)
"""Texts in place of a number or a word."""


# --- damage ---


def flips(content, chance):
    """Flip one to eight bits."""
    damaged = bytearray(content)
    for _ in range(chance.randint(1, 8)):
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
    return bytes(damaged)


def cut(content, chance):
    """Leave out the end."""
    return content[: chance.randrange(len(content))]


def word(content, chance):
    """Replace numbers or words by other texts."""
    places = [*re.finditer(rb"[-+.\w]+", content)]
    for place in sorted(
        chance.sample(places, chance.choice((1, 1, 3))),
        key=lambda found: -found.start(),
    ):
        text = chance.choice(WORDS).encode()
        content = content[: place.start()] + text + content[place.end() :]
    return content


def nest(content, chance):
    """Replace a number or a word by deep brackets, tags or tables."""
    places = [*re.finditer(rb"[-+.\w]+", content)]
    place = chance.choice(places)
    depth = chance.choice((10, 200, 900, 100_000))
    opened, closed = chance.choice(
        (
            (b"[", b"]"),
            (b'{"a":', b"}"),
            (b"<a>", b"</a>"),
            (b"a.", b""),
            (b"{a=", b"}"),
        )
    )
    inner = opened * depth + b"1" + closed * chance.choice((0, depth))
    return content[: place.start()] + inner + content[place.end() :]


def encode(content, chance):
    """Write the text in another encoding, or bytes that are none."""
    text = content.decode("latin-1")
    return chance.choice(
        (
            text.encode("utf-16"),
            text.encode("utf-32"),
            b"\xef\xbb\xbf" + content,
            text.replace("e", "\u00e9").encode("latin-1"),
            text.replace("a", "\u00e4").encode(),
            content.replace(b"\n", b"\r"),
            content.replace(b" ", b"\0", 1),
            b"\xff\xfe" + content,
        )
    )


def void(content, chance):
    """Leave nothing, or what has no meaning."""
    return chance.choice(
        (b"", b"\n", b" \t", b"\0" * 64, b"null", b"[]", b"{}", b"0", b"#")
    )


def json_value(content, chance):
    """Replace, drop or add a value somewhere in a JSON document."""
    lines = content.splitlines() if content.count(b"\n{") else [content]
    number = chance.randrange(len(lines))
    document = json.loads(lines[number])
    for _ in range(chance.choice((1, 1, 2))):
        parent, key = None, None
        value = document
        while (
            isinstance(value, dict | list)
            and value
            and (parent is None or chance.random() < 0.75)
        ):
            parent = value
            key = chance.choice(
                [*value] if isinstance(value, dict) else range(len(value))
            )
            value = parent[key]
        if chance.random() < 0.2:
            del parent[key]
        else:
            parent[key] = chance.choice(WRONG)
    lines[number] = json.dumps(document).encode()
    return b"\n".join(lines)


def npz_value(content, chance):
    """Change, drop or add an array of an archive."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = dict(archive)
    name = chance.choice([*arrays])
    array = arrays.pop(name)
    change = chance.randrange(10)
    if change:
        arrays[name] = (
            lambda: None,
            lambda: array[:0],
            lambda: array[..., None],
            lambda: np.float64(1.0),
            lambda: array.astype(str),
            lambda: array.astype(complex),
            lambda: np.full(array.shape, chance.choice((np.nan, np.inf, 1e308))),
            lambda: array.ravel(),
            lambda: np.array([{}], dtype=object),
            lambda: array[: len(array) // 2] if array.ndim else array,
        )[change]()
    stream = io.BytesIO()
    np.savez(
        stream,
        **arrays,
        **{chance.choice(("g", "about", "mean", "extra")) + "_": np.zeros(2)},
    )
    return stream.getvalue()


BINARY = (flips, flips, cut, void)
TEXT = (*BINARY, word, word, word, nest, encode)


def damaged(name, content, chance):
    """Return a damaged content of a file of this name."""
    kinds = {
        ".npz": (*BINARY, npz_value, npz_value),
        ".json": (*TEXT, json_value, json_value, json_value),
        **dict.fromkeys((".mp4", ".parquet", ".usdc"), BINARY),
    }
    for _ in range(chance.choice((1, 1, 1, 2))):
        kind = chance.choice(kinds.get(Path(name).suffix, TEXT))
        try:
            content = kind(content, chance)
        except (ValueError, IndexError, KeyError, TypeError, EOFError):
            # The first damage left nothing that the second could read.
            continue
        except Exception:  # An archive of flipped bits raises anything.
            continue
    return content


# --- contents ---


def packed(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def frames_of(name):
    """Return g(t) of a run at the frames, shape [frame_count, coordinate_count]."""
    return run_episode(RunRequest(name)).trajectory.frames[1]


def csv_of(table):
    return "\n".join(
        [
            ",".join(table),
            *(",".join(map(str, row)) for row in zip(*table.values(), strict=True)),
        ]
    ).encode()


def edited_result():
    """Return a result whose scene is in the file."""
    from gauge_envs.formats.usd import to_usd

    to_usd(load_experiment(ID, {"cube.friction": 0.3}).scene, Path("edited.usda"))
    result = run_episode(RunRequest(ID, asset="edited.usda"))
    return json.dumps(result.to_dict()).encode()


def own_json():
    jitter = {"position_m": 0.001}
    content = {"id": ID, "g": frames_of(ID).tolist(), "jitter": jitter}
    return json.dumps(content).encode()


def own_csv():
    titles = ("cube.x", "cube.y", "cube.z")
    return csv_of(dict(zip(titles, frames_of(ID).T, strict=True)))


def log_table():
    times_s = np.arange(60) / 50
    return {
        "t": times_s,
        "q_hinge": np.sin(times_s),
        "dq_hinge": np.cos(times_s),
        "target_hinge": np.sin(times_s + 0.1),
        "command_t": times_s,
    }


def parquet():
    import pyarrow
    from pyarrow import parquet as writer

    stream = io.BytesIO()
    writer.write_table(pyarrow.table(log_table()), stream)
    return stream.getvalue()


def film():
    import cv2

    file = Path("film.mp4")
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, (64, 48))
    for number in range(12):
        writer.write(np.full((48, 64, 3), 20 * number, np.uint8))
    writer.release()
    return file.read_bytes()


def probe():
    model = mujoco.MjModel.from_xml_path(
        str(ROOT / "examples" / "replay" / "double_pendulum.xml")
    )
    gauge_probe.save(SimpleNamespace(mj_model=model), "made.gaugeprobe.json")
    return Path("made.gaugeprobe.json").read_bytes()


def usdc():
    from pxr import Usd

    Usd.Stage.Open(str(ROOT / "assets" / "usd" / f"{ID}.usda")).Export("made.usdc")
    return Path("made.usdc").read_bytes()


def an_import():
    facts = ImportFacts(
        variant=ID,
        left_out=0,
        files=("a",),
        files_sha256="0",
        task_sha256="1",
        metrics={},
        drivers=(),
    )
    write_imported(load_band(ID), {}, facts)
    return imported_file(ID).read_bytes()


def trial():
    content = trial_content({"cube": body_asset(frames_of(ID))})
    return json.dumps(content).encode()


URDF = b"""<robot name="arm">
  <link name="base"/>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.1 0.1 0.2"/></geometry></collision></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="3"/></joint>
</robot>
"""

MAP = b"""unit = "rad"
quaternion = "wxyz"
order = ["hinge"]

[joints.hinge]
log = "hinge"
sign = -1
offset_rad = 0.1

[control]
kp = 20.0
kd = { hinge = 0.5 }
action_scale = 0.25
"""

TRACK = b"frame,time,x,y\n" + b"\n".join(
    b"%d,%f,%d,%d" % (n, n / 30, 10 + n, 20 + n) for n in range(20)
)

EXPECTED = b"""[rebound-flat]
measured = 0.513
reason = "each point rebounds"

[unsupported]
"cloth-*" = "rigid bodies only"
"""


# --- readers ---


def read_results(file):
    """Read a result as `gauge compare` and `gauge report` do."""
    results, _ = loaded_results([str(file)], with_scene=True)
    summary_document([*results.values()], details=True)
    group_by_configuration(results.values())
    for result in results.values():
        json.dumps(result.to_dict())
    if not results:
        load_result(file)


def read_scored(file):
    """Score a trajectory file."""
    result, _ = score_file(file, variant=ID)
    json.dumps(result.to_dict())


def read_scored_as_written(file):
    """Score a result in the scene of the file."""
    score_file(file)


def read_own(file):
    """Read an experiment of a user with its band."""
    # A family belongs to one file in a process.
    folder = Path(tempfile.gettempdir(), f"gauge-own-{os.getpid()}")
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(OWN, folder)
    (folder / file.name).unlink()
    (folder / file.name).symlink_to(file)
    # The cache of bands tells files by their time.
    (folder / "CrateSlide-pine.band.toml").touch()
    reference_band(load_experiment(str(folder / "crate.toml")))
    shutil.rmtree(folder)


def read_import(file):
    """Read an import."""
    stored = imported_file(ID)
    stored.parent.mkdir(parents=True, exist_ok=True)
    stored.unlink(missing_ok=True)
    stored.symlink_to(file)
    # The cache of bands tells files by their time.
    read_import.count += 1
    if file.exists():
        os.utime(stored, ns=(read_import.count, read_import.count))
    load_imported(ID)
    reference_band(load_experiment(ID, reference="imported"))


read_import.count = 0


def read_trials(file):
    """Import trials, of which one is the file; a damaged one is a finding."""
    root = file.parent / "dataset"
    shutil.rmtree(root, ignore_errors=True)
    link = write_trial(root, ID, 1, b"")
    link.unlink()
    link.symlink_to(file)
    for imported in import_trials(find_trials(root)):
        json.dumps([asdict(finding) for finding in imported.findings])


def read_swept(file):
    """Read the folder of a sweep; a damaged result is a note."""
    folder = file.parent / "swept"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / file.name).symlink_to(file)
    earlier_outcomes(folder, lambda text: None)


def read_asset(file):
    """Read a scene of an experiment from a file."""
    load_experiment(ID, asset=file)


def read_robot(file):
    """Read a model with the texts that errors quote."""
    robot = configuration(file).robot
    assert robot.text is None or robot.text.root


def read_film(file):
    """Read all frames of a video."""
    for _ in FileFrames(file):
        pass


def example(*parts):
    return ROOT.joinpath(*parts).read_bytes


def a_result():
    return json.dumps(run_episode(RunRequest(ID)).to_dict()).encode()


TARGETS = {
    "results/result.json": (a_result, read_results),
    "scored/result.json": (a_result, read_scored),
    "edited/result.json": (edited_result, read_results),
    "edited/scored.json": (edited_result, read_scored_as_written),
    "swept/result.json": (a_result, read_swept),
    "g.json": (own_json, read_scored),
    "g.npz": (lambda: packed(g=frames_of(ID), time_s=np.arange(19) / 30), read_scored),
    "g.csv": (own_csv, read_scored),
    "task.toml": (example("tasks", "pendulum.toml"), load_task),
    "crate.toml": (example("examples", "own_experiment", "crate.toml"), read_own),
    "CrateSlide-pine.band.toml": (
        example("examples", "own_experiment", "CrateSlide-pine.band.toml"),
        read_own,
    ),
    "CrateSlide-pine.band.npz": (
        example("examples", "own_experiment", "CrateSlide-pine.band.npz"),
        read_own,
    ),
    f"{ID}.npz": (an_import, read_import),
    "trial.json": (trial, read_trials),
    "conformance.json": (example("scoring", "conformance.json"), read_columns),
    "expected.toml": (lambda: EXPECTED, read_known_failures),
    "sweep.toml": (example("examples", "sweep.toml"), load_sweep_file),
    "scene.usda": (
        example("assets", "usd", f"{ID}.usda"),
        lambda file: from_usd(file, duration_s=1.0),
    ),
    "asset.usda": (example("assets", "usd", f"{ID}.usda"), read_asset),
    "scene.usdc": (usdc, lambda file: from_usd(file, duration_s=1.0)),
    "asset.xml": (example("assets", "mjcf", f"{ID}.xml"), read_asset),
    "robot.xml": (example("examples", "replay", "double_pendulum.xml"), read_robot),
    "replay.xml": (example("examples", "replay", "double_pendulum.xml"), load_model),
    "robot.urdf": (lambda: URDF, read_robot),
    "robot.gaugeprobe.json": (probe, configuration),
    "settings.toml": (example("examples", "sanity", "good.toml"), configuration),
    "log.csv": (lambda: csv_of(log_table()), read_log),
    "log.npz": (lambda: packed(**log_table()), read_log),
    "log.parquet": (parquet, read_log),
    "map.toml": (lambda: MAP, read_map),
    "track.csv": (lambda: TRACK, read_track),
    "film.mp4": (film, read_film),
}
"""Content of a whole file, and its reader, by name."""


def faults(name, folder, seeds):
    """Read damaged files of a kind, and return what is wrong: errors of another type or without the name of the file.

    Args:
        name: Key of `TARGETS`.
        folder: Empty folder, which holds the last damaged file after a crash.
        seeds: Seeds of the damages.

    Returns:
        A line for each fault, and the number of files that were read without an error.
    """
    os.chdir(folder)
    os.environ["GAUGE_DATA_DIR"] = str(folder)
    mujoco.set_mju_user_warning(lambda text: None)
    content, read = TARGETS[name]
    whole = content()
    file = folder / Path(name).name
    found, good = [], 0
    file.write_bytes(whole)
    read(file)
    for seed in seeds:
        file.write_bytes(damaged(name, whole, random.Random(f"{name} {seed}")))
        fault = fault_of(read, file)
        good += fault is None
        if fault:
            found.append(f"{name}, seed {seed}: {fault}")
    return found, good


def special_faults(name, folder):
    """Read a pipe, a folder, a device and nothing in place of a file, and return what is wrong."""
    os.chdir(folder)
    os.environ["GAUGE_DATA_DIR"] = str(folder)
    _, read = TARGETS[name]
    file = folder / Path(name).name
    found = []
    endless = Path("endless")
    endless.symlink_to("/dev/zero")
    for make in (os.mkfifo, os.mkdir, endless.rename, Path.touch):
        make(file)
        fault = fault_of(read, file)
        found += [fault] if fault else []
        (Path.rmdir if file.is_dir() else Path.unlink)(file)
    fault = fault_of(read, file)
    return found + ([fault] if fault else [])


def fault_of(read, file):
    """Return what is wrong with the error of a damaged file; empty for a right error, None without an error."""
    with warnings.catch_warnings(action="ignore"):
        try:
            read(file)
        except GaugeError as error:
            text = str(error)
            if "\n" not in text and (file.name in text or file.stem in text):
                return ""
            return f"{type(error).__name__} {text!r}"
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            return f"{type(error).__name__} {str(error)[:200]!r} in {place}"
    return None
