"""Files of strangers: what is no regular file, too large, too deep or a bomb is refused in little time and memory."""

from __future__ import annotations

import ast
import io
import os
import stat
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pxr import Sdf, Usd

from gauge_envs import files, load_experiment
from gauge_envs.errors import (
    AssetError,
    GaugeError,
    ReferenceFileError,
    TrajectoryFileError,
)
from gauge_envs.evaluation import trajectory_file
from gauge_envs.evaluation.trajectory_file import read_trajectory
from gauge_envs.experiments.resolve import load_experiment_from_asset
from gauge_envs.files import (
    MEGABYTE,
    json_document,
    npz_arrays,
    read_regular,
    toml_document,
    write_whole,
)
from gauge_envs.references.convergence import read_convergence
from gauge_envs.references.tables import csv_header
from gauge_envs.runs.result_file import load_result
from gauge_envs.tools.sanity.stacks import configuration
from gauge_envs.tools.usd import source
from gauge_envs.tools.usd.experiment_file import load_experiment_file
from gauge_envs.tools.usd.reader import from_usd

NAME = "SlopeSlider-2-wood"


def fifo(file):
    os.mkfifo(file)


def device(file):
    file.symlink_to("/dev/zero")


def sparse(file):
    with file.open("wb") as stream:
        stream.truncate(10**12)


READERS = {
    "result.json": load_result,
    "g.csv": lambda file: read_trajectory(file, load_experiment(NAME)),
    "g.npz": lambda file: read_trajectory(file, load_experiment(NAME)),
    "scene.usda": from_usd,
    "scene.usdc": from_usd,
    "scene.xml": lambda file: load_experiment_from_asset(NAME, file),
    "own.toml": load_experiment_file,
    "band.csv": csv_header,
    "settings.toml": configuration,
    "settings.json": configuration,
    "robot.xml": configuration,
    "convergence.csv": read_convergence,
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("make", [fifo, device, Path.mkdir, sparse])
def test_only_regular_files_of_limited_size_are_read(name, make, tmp_path):
    file = tmp_path / name
    make(file)
    reason = "it is not a regular file"
    if make is sparse:
        reason = r"1e\+06 MB, the limit is"
    with pytest.raises(GaugeError, match=reason) as caught:
        READERS[name](file)
    assert str(file) in str(caught.value)


HEADER = '#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n)\n'


def test_a_file_that_grows_while_it_is_read_is_limited(tmp_path, monkeypatch):
    file = tmp_path / "a"
    file.write_bytes(b"1234567")
    monkeypatch.setattr("gauge_envs.files._check_regular", lambda *_: None)
    assert read_regular(file, 7) == b"1234567"
    with pytest.raises(OSError, match="larger than the limit"):
        read_regular(file, 6)


def test_a_name_with_a_null_character_is_an_error():
    with pytest.raises(OSError, match="null character"):
        read_regular(Path("a\0b"), 10)


@pytest.mark.parametrize("mask", [0o002, 0o022, 0o077])
def test_modes_follow_the_umask(mask, tmp_path):
    before = os.umask(mask)
    try:
        write_whole(tmp_path / "a.json", b"{}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == 0o666 & ~mask


# --- documents -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"[" * 100_000 + b"]" * 100_000, "nested too deeply"),
        (b"9" * 10_000, "4300 digits"),
        (b"[" + b"{}," * 1_000_001 + b"0]", "1000002 objects and lists"),
    ],
)
def test_json_is_limited(content, reason):
    with pytest.raises(ValueError, match=reason):
        json_document(content)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"a = " + b"[" * 100_000, "nested too deeply"),
        (b"a = " + b"9" * 10_000, "4300 digits"),
        (b"a." * 100_000 + b"a = 1", "100000 dots"),
        (b"x = {" + b"a . " * 100_000 + b"a = 1}", "100000 dots"),
        (b"# \n" * 1_000_000, "the limit is"),
        (b"a = '\xff'", "utf-8"),
    ],
)
def test_toml_is_limited(content, reason):
    with pytest.raises(ValueError, match=reason):
        toml_document(content)


def npz(**members):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def npy(values):
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


@pytest.mark.parametrize("dtype", ["f8", ">f4", "i2", "u1", "?"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_are_those_of_numpy(dtype, order):
    values = np.asarray(np.arange(12).reshape(3, 4) % 2, dtype=dtype, order=order)
    (found,) = npz_arrays(
        npz(a=npy(values), b=b"damaged"), ["a", "gone"], MEGABYTE
    ).values()
    np.testing.assert_array_equal(found, values)
    assert found.dtype == values.dtype


def test_an_array_that_is_not_used_is_not_read():
    content = npz(a=npy(np.ones(3)), bomb=npy(np.zeros(5_000_000)))
    tracemalloc.start()
    npz_arrays(content, ["a"], MEGABYTE)
    assert tracemalloc.get_traced_memory()[1] < 5 * MEGABYTE
    tracemalloc.stop()
    with pytest.raises(
        ValueError,
        match="bomb: it has 40000128 bytes, the limit of all arrays is 1000000",
    ):
        npz_arrays(content, ["a", "bomb"], MEGABYTE)


def test_a_header_that_states_more_than_the_file_holds_is_refused():
    header = npy(np.ones((1, 1))).replace(b"(1, 1)", b"(9**9,)")
    for content in (
        header,
        npy(np.ones((2, 2))).replace(b"(2, 2)", b"(9, 9)"),
        npy(np.array([{}], dtype=object)),
    ):
        with pytest.raises(
            ValueError, match=r"does not fit|expected numbers|malformed node"
        ):
            npz_arrays(npz(a=content), ["a"], MEGABYTE)


def test_a_trajectory_in_a_bomb_is_refused(tmp_path, monkeypatch):
    assert trajectory_file.MOST_ARRAY_BYTES < 300 * MEGABYTE
    monkeypatch.setattr(trajectory_file, "MOST_ARRAY_BYTES", 30 * MEGABYTE)
    file = tmp_path / "g.npz"
    file.write_bytes(npz(g=npy(np.zeros((4_000_000, 1)))))
    assert len(file.read_bytes()) < MEGABYTE
    with pytest.raises(
        TrajectoryFileError, match="g: it has 32000128 bytes, the limit"
    ):
        read_trajectory(file, load_experiment(NAME))


def test_a_table_that_is_no_csv_is_refused(tmp_path):
    file = tmp_path / "band.csv"
    file.write_text(f"frame,{'x' * 200_000}\n")
    with pytest.raises(ReferenceFileError, match="line 1: is not CSV in UTF-8: "):
        csv_header(file)


# --- scenes ----------------------------------------------------------------------------------------------------------


def exponential(levels):
    """A layer in which each class refers ten times to the one before it."""
    layers = ['class "L0" { double a = 1 }']
    for level in range(1, levels):
        children = "\n".join(
            f'def "c{k}" (inherits = </L{level - 1}>) {{}}' for k in range(10)
        )
        layers.append(f'class "L{level}" {{\n{children}\n}}')
    return (
        HEADER
        + "\n".join(layers)
        + f'\ndef "World" (inherits = </L{levels - 1}>) {{}}\n'
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            HEADER + "\n".join(f'def "p{n}" {{}}' for n in range(30_000)),
            "more than 20000 prims",
        ),
        (exponential(9), "prims|memory|processor time"),
    ],
    ids=["many prims", "exponential"],
)
def test_a_layer_of_too_many_prims_is_refused(text, reason, tmp_path):
    file = tmp_path / "bomb.usda"
    file.write_text(text)
    with pytest.raises(AssetError, match=reason):
        from_usd(file, duration_s=1.0)


@pytest.mark.parametrize("damage", ["cut", "endless array"])
def test_a_binary_layer_that_the_child_cannot_read_is_not_opened(
    damage, tmp_path, monkeypatch
):
    """A damaged layer took 4 GB before USD found the damage; the child stops at its limit."""
    numbers = [7 * n * n for n in range(20)]
    layer = Sdf.Layer.CreateAnonymous(".usda")
    world = f'def "World" {{\n    custom int[] a = {numbers}\n}}\n'
    layer.ImportFromString(HEADER + world)
    file = tmp_path / "bomb.usdc"
    layer.Export(str(file))
    content, count = file.read_bytes(), struct.pack("<Q", len(numbers))
    assert content.count(count) == 1
    endless = content.replace(count, struct.pack("<Q", 2**31))
    file.write_bytes(content[:-40] if damage == "cut" else endless)
    monkeypatch.setattr(source, "Usd", SimpleNamespace(Object=Usd.Object, Stage=None))
    words = "is not a readable USD file|a value cannot be read|more than"
    with pytest.raises(AssetError, match=words):
        from_usd(file)


@pytest.mark.usefixtures("real_children")
@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (
            '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
            "memory|too large|MuJoCo",
        ),
        (
            '<worldbody><replicate count="10000000" offset="1 0 0"><geom size="1"/></replicate></worldbody>',
            "memory|processor time",
        ),
        ('<size memory="100G"/>', "memory"),
    ],
    ids=["height field", "replicate", "arena"],
)
def test_a_model_that_takes_all_memory_is_refused(body, reason, tmp_path, monkeypatch):
    assert files.child_refusal.__kwdefaults__["cpu_s"] == files.CHILD_CPU_S
    monkeypatch.setitem(files.child_refusal.__kwdefaults__, "cpu_s", 1)
    file = tmp_path / "bomb.xml"
    file.write_text(f"<mujoco>{body}</mujoco>")
    with pytest.raises(AssetError, match=reason):
        load_experiment_from_asset(NAME, file)


@pytest.mark.usefixtures("real_children")
def test_a_lower_limit_of_the_session_refuses_no_file(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("print(1)")
    program = f"from gauge_envs import files; assert files.child_refusal({str(script)!r}, cpu_s=60) is None"
    command = ["bash", "-c", 'ulimit -t 30; "$0" -c "$1"', sys.executable, program]
    assert subprocess.run(command, check=False).returncode == 0


@pytest.mark.parametrize("step", ["nan", "0", "-1", "1e-320"])
def test_a_time_step_that_is_no_step_is_refused(step, tmp_path):
    file = tmp_path / "step.xml"
    file.write_text(f'<mujoco><option timestep="{step}"/></mujoco>')
    with pytest.raises(AssetError, match=r"timestep|MuJoCo cannot load"):
        load_experiment_from_asset(NAME, file)


OPENING = {
    "open", "read_text", "read_bytes", "fromfile", "genfromtxt", "loadtxt", "imread", "VideoCapture", "connect",
    "np.load", "json.load", "pickle.load", "pickle.loads", "zipfile.ZipFile", "tarfile.open", "lzma.open", "gzip.open",
}  # fmt: skip
"""Calls that read a file, by the name of the method, or with the name of the module."""

OPENING_NAMES = OPENING - {"read_bytes", "read_text"}
OPENING_LAST = {name.rpartition(".")[2] for name in OPENING}

WITHOUT_LIMITS = {
    "cli/streams.py": "the null device",
    "registry.py": "files of installed packages",
    "backends/pybullet/world.py": "the null device",
    "backends/settings.py": "a file of the package",
    "pages/html.py": "a file of the package",
    "runs/isolation.py": "files of the kernel, and the null device",
    "runs/replay.py": "a result that was read within limits before",
    "runs/result_file.py": "a layer that was written just before",
    "tools/assets/build.py": "assets that this command wrote",
    "tools/catalog/overview.py": "files of the package",
    "tools/conformance/continuation.py": "a state in memory",
    "tools/conformance/run.py": "a task of this process in memory",
    "tools/conformance/model.py": "a file of the package",
    "tools/sanity/command.py": "a file of the package",
    "tools/sanity/gauge_probe.py": "runs in the environment that it reads, without this package",
    "tools/sanity/phenomena/__init__.py": "a file of the package",
    "tools/site/build.py": "files of the package",
    "tools/site/reproduce.py": "results that were read within limits before",
    "tools/sweep/folder.py": "results that this command wrote",
    "tools/versions/episodes_worker.py": "runs in an environment of its own, without this package",
    "tools/versions/processes.py": "what the worker wrote",
    "tools/versions/environments.py": "records that this command wrote",
    "tools/versions/worker.py": "runs in an environment of its own, without this package",
    "tools/video/frames.py": "a limited head of the file; OpenCV by size and count of frames",
    "tools/video/prompts.py": "a file of the package",
    "tools/video/tasks.py": "files of the package",
}  # fmt: skip
"""Files with a call that reads beside `files.read_regular`, and what they read."""


def reading_calls(source):
    """Return the calls of a module that read files: methods, and functions of modules."""
    found = set()
    for one in ast.walk(ast.parse(source)):
        if not isinstance(one, ast.Call):
            continue
        is_method = isinstance(one.func, ast.Attribute)
        last = one.func.attr if is_method else getattr(one.func, "id", "")
        if last not in OPENING_LAST:
            continue
        name = ast.unparse(one.func)
        if (is_method and last in OPENING) or name in OPENING_NAMES:
            found.add(name)
    return found


def test_a_file_of_a_stranger_has_one_reader():
    package = Path(files.__file__).parent
    reading = {
        str(file.relative_to(package)): calls
        for file in package.rglob("*.py")
        if (calls := reading_calls(file.read_text()))
    }
    del reading["files.py"]
    assert {
        name: calls for name, calls in reading.items() if name not in WITHOUT_LIMITS
    } == {}
    assert set(WITHOUT_LIMITS) <= set(reading)
