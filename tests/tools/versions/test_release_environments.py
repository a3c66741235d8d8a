"""Environments of releases: how they are named, made, removed, and why one cannot be made; and their worker."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import mujoco
import pytest
from planted_models import SCENE, side

from gauge_envs.errors import ParameterError
from gauge_envs.tools.versions import environments, sides, worker
from gauge_envs.tools.versions.environments import ReleaseError
from gauge_envs.tools.versions.processes import Bench, VersionsError
from gauge_envs.tools.versions.sides import read_side


def test_versions_are_read():
    (one,) = read_side("mujoco==3.3.0:iterations=4", {"iterations": 4})
    assert (one.title, one.requirement) == (
        "mujoco==3.3.0:iterations=4",
        "mujoco==3.3.0",
    )
    assert [end.requirement for end in read_side("mujoco==3.1.0..4.0.0")] == [
        "mujoco==3.1.0",
        "mujoco==4.0.0",
    ]
    assert read_side("mujoco")[0].python == sys.executable
    for wrong in (
        "newton==1.0",
        "mujco==3.3.0",
        "mujoco==new",
        "mujoco=3.3.0",
        "mujoco>=3",
    ):
        with pytest.raises(ParameterError, match="expected mujoco=="):
            read_side(wrong)


LACKS = "ERROR: Could not find a version that satisfies the requirement mujoco==9.9.0"
UNFETCHED = "Could not fetch URL i/simple/: connection error: (Caused by E('[Errno"


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (f"{LACKS} (from versions: 3.3.0, 3.9.0)", "no such version .*has 3.9.0"),
        (f"{LACKS} (from versions: none)", "no package mujoco"),
        (
            f"{UNFETCHED} -3] No name')) - skipping\n{LACKS} (from versions: 3.3.0)",
            "i/simple/ does not answer: No name",
        ),
        (f"{UNFETCHED} 5] No'), ProxyError)) - skipping\n", "the proxy"),
        (
            f"Could not fetch URL i: 404 No - skipping\n{LACKS} (from versions: none)",
            "no package mujoco",
        ),
        (
            f"  Skipping link: none: i/mujoco-9.9.0-cp39.whl\n{LACKS} (from versions: 3.3.0)",
            "no wheel",
        ),
        (
            f"{LACKS.replace('mujoco==9.9.0', 'gltf==1.0 (from mujoco)')} (from versions: none)",
            "needs gltf",
        ),
        ("OSError: [Errno 28] No space left on device", "disk is full"),
        ("[Errno 30] Read-only file system", "cannot be written"),
        ("cause: Because there is no version of mujoco==9.9.0 and", "no such version"),
        (
            "cause: Because mujoco==9.9.0 has no usable wheels and",
            "no wheel of mujoco==9.9.0",
        ),
        (
            "cause: Failed to fetch: `i/`\n  cause: error\n  cause: dns",
            "i/ does not answer: dns",
        ),
        ("hint: unavailable because the network was disabled", "does not answer"),
        (
            f"Ignoring indexes: i/simple\n{LACKS} (from versions: 3.3.0)",
            "no-index .*it has 3.3.0. Environments that can be used without it: none",
        ),
        ("error: something else", "something else"),
    ],
)
def test_why_an_installation_failed(tmp_path, monkeypatch, said, told):
    monkeypatch.setenv("GAUGE_CACHE_DIR", str(tmp_path))
    failed = subprocess.CompletedProcess([], 1, "", said)
    monkeypatch.setattr(environments.venv.EnvBuilder, "create", lambda self, at: None)
    monkeypatch.setattr(environments.shutil, "which", lambda name: None)
    monkeypatch.setattr(environments, "_run", lambda command: failed)
    with pytest.raises(ReleaseError, match=told):
        environments.made_environment("mujoco==9.9.0", lambda text: None)
    assert [one.name for one in (tmp_path / "versions").iterdir()] == [".locks"]


def test_nothing_half_made_is_used(tmp_path, monkeypatch):
    """Ctrl-C during an installation leaves nothing; what a killed process left goes at the next one."""
    monkeypatch.setenv("GAUGE_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(environments.shutil, "which", lambda name: None)

    def create(self, at):
        (at / "bin").mkdir(parents=True)
        (at / "bin" / "python").touch()

    def write_on(folder):
        # A child of pip that was interrupted too ends a moment later.
        for index in range(30):
            with suppress(FileNotFoundError):
                folder.mkdir(parents=True, exist_ok=True)
                (folder / f"{index}.py").touch()
            time.sleep(0.01)

    def interrupted(command):
        child = threading.Thread(target=write_on, args=(Path(command[0]).parent,))
        child.start()
        children.append(child)
        raise KeyboardInterrupt

    children = []
    monkeypatch.setattr(environments.venv.EnvBuilder, "create", create)
    monkeypatch.setattr(environments, "_run", interrupted)
    place = environments.environment_folder("mujoco==3.3.0")
    killed = place.with_name(f".{place.name}.killed")
    killed.mkdir(parents=True)
    with pytest.raises(KeyboardInterrupt):
        environments.made_environment("mujoco==3.3.0", lambda text: None)
    children[0].join()
    assert [one.name for one in (tmp_path / "versions").iterdir()] == [".locks"]
    assert not environments.is_made("mujoco==3.3.0")
    done = subprocess.CompletedProcess([], 0, "", "")
    monkeypatch.setattr(environments, "_run", lambda command: done)
    said = []
    environments.made_environment("mujoco==3.3.0", said.append)
    assert environments.is_made("mujoco==3.3.0")
    assert str(environments.environment_folder("mujoco==3.3.0")) in said[0]
    assert "MB" in said[0]
    environments.made_environment("mujoco==3.3.0", said.append)
    assert len(said) == 2
    # A Python that is gone takes its environments with it.
    (environments.environment_folder("mujoco==3.3.0") / "bin" / "python").unlink()
    assert not environments.is_made("mujoco==3.3.0")
    environments.made_environment("mujoco==3.3.0", said.append)
    assert environments.is_made("mujoco==3.3.0")
    environments.remove_environment("mujoco==3.3.0")
    assert not environments.is_made("mujoco==3.3.0")


def test_after_an_interrupt_no_side_installs_anything_more():
    goes_on = threading.Event()
    runs = [sys.executable, "-c", ""]

    def installed():
        goes_on.wait()
        return environments._run(runs)

    with suppress(KeyboardInterrupt), environments.sides_at_once() as pool:
        side = pool.submit(installed)
        # The thread goes on when the main one waits for it.
        threading.Timer(0.2, goes_on.set).start()
        raise KeyboardInterrupt
    assert isinstance(side.exception(), ReleaseError)
    assert environments._run(runs).returncode == 0


def started(folder, model):
    """Start the command on a release that is not installed yet."""
    words = ["backend", "versions", str(model), "mujoco==3.3.0", "mujoco", "--steps=3"]
    return subprocess.Popen(
        [sys.executable, "-c", "import gauge_command; gauge_command.main()", *words],
        # With a cache it is installed before an interrupt comes.
        env=os.environ
        | {"GAUGE_CACHE_DIR": str(folder), "UV_NO_CACHE": "1", "PIP_NO_CACHE_DIR": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell in the background ignores interrupts, which its children inherit.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


@pytest.mark.slow
def test_an_interrupted_installation_leaves_nothing_and_two_at_once_make_one(tmp_path):
    """It needs a package index."""
    model = tmp_path / "scene.xml"
    model.write_text(SCENE)
    interrupted = started(tmp_path, model)
    assert "installed into" in interrupted.stderr.readline()
    deadline_s = time.monotonic() + 60.0
    while not list((tmp_path / "versions").glob(".mujoco-*")):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    # A terminal interrupts the command with its children.
    os.killpg(interrupted.pid, signal.SIGINT)
    assert interrupted.wait(timeout=60.0) == 130
    assert [one.name for one in (tmp_path / "versions").iterdir()] == [".locks"]
    both = [started(tmp_path, model) for _ in range(2)]
    said = [one.communicate()[1] for one in both]
    assert [one.returncode for one in both] in ([0, 0], [1, 1])
    assert sum("installed into" in text for text in said) == 1
    made = [one.name for one in (tmp_path / "versions").iterdir()]
    assert len(made) == 2
    assert not [name for name in made if name.startswith(".mujoco")]


def test_a_range_without_two_releases_and_one_without_the_index(tmp_path, monkeypatch):
    python = Path(sys.executable)
    monkeypatch.setattr(sides, "made_environment", lambda *words: python)
    monkeypatch.setattr(sides, "released_versions", lambda *words: ["3.3.0", "3.9.0"])
    with pytest.raises(ParameterError, match=r"no two releases .*3\.3\.0, 3\.9\.0"):
        sides.releases_between(*read_side("mujoco==3.3.0..3.3.9"), print)

    def without_index(*words):
        raise ReleaseError("i does not answer")

    monkeypatch.setattr(sides, "released_versions", without_index)
    made = ["mujoco==3.10.0", "mujoco==3.3.0", "mujoco==3.9.0"]
    monkeypatch.setattr(sides, "made_requirements", lambda: made)
    said = []
    found = sides.releases_between(*read_side("mujoco==3.3.0..4.0.0"), said.append)
    assert [one.title for one in found] == [made[1], made[2], made[0]]
    assert "does not answer" in said[0]


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"jacobian": "densest"}, "jacobian=densest: expected one of dense, sparse"),
        ({"iterations": "many"}, "iterations=many: expected a value as 100"),
        ({"gravity": [0, 0]}, "gravity=.* -9.81"),
        ({"timestep": 0.0}, "positive"),
    ],
)
def test_a_setting_that_is_none_says_what_would_be_one(settings, told):
    with pytest.raises(SystemExit, match=told):
        worker.set_options(mujoco.MjModel.from_xml_string("<mujoco/>"), settings)


@pytest.mark.parametrize(
    ("text", "told"), [("", "cannot be started"), ("#!/bin/sh\n", "it is no Python")]
)
def test_a_file_that_is_no_python_is_named(tmp_path, text, told):
    file = tmp_path / "python"
    file.write_text(text)
    file.chmod(0o755 if text else 0o644)
    bench = Bench(tmp_path / "scene.xml", tmp_path, steps=1, seed=0)
    with pytest.raises(VersionsError, match=told):
        bench.run(sides.of_interpreter(file))


def test_a_worker_that_fails_says_why(tmp_path):
    model = tmp_path / "newer.xml"
    model.write_text(SCENE.replace("<body", "<newer/><body"))
    bench = Bench(model, tmp_path, steps=1, seed=0)
    with pytest.raises(
        VersionsError, match=r"old cannot run .*newer.xml: .*XML.*newer"
    ):
        bench.run(side("old"))


def test_a_setting_that_a_release_lacks_is_left_out_and_listed(tmp_path):
    """The meshes are found from the copy without it."""
    (tmp_path / "made").mkdir()
    (tmp_path / "parts").mkdir()
    text = (
        SCENE.replace(
            "<option", '<compiler meshdir="parts"/><option newer="1" cone="round"'
        )
        .replace(
            "<worldbody>", '<asset><mesh name="m" file="m.obj"/></asset><worldbody>'
        )
        .replace(
            '<geom name="box"',
            '<geom type="mesh" mesh="m" newest="a b"/><geom name="box"',
        )
    )
    model = tmp_path / "scene.xml"
    model.write_text(text)
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    faces = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "parts" / "m.obj").write_text(corners + faces)
    compiled, dropped = worker.without_unknown(model, tmp_path / "made")
    assert dropped == ['option newer="1"', 'geom newest="a b"', 'option cone="round"']
    assert compiled.opt.timestep == 0.004
    assert compiled.nmesh == 1
    assert model.read_text() == text


class OfMuJoCo3:
    """Reads models as MuJoCo 3.12: MuJoCo 4 writes `input` of all actuators."""

    installed = mujoco.MjModel

    @classmethod
    def from_xml_path(cls, path):
        if ' input="pos"' in Path(path).read_text():
            raise ValueError(
                "Error: input is only available for so3, pid and dcmotor actuators, actuator 'servo' (id = 0)\n"
                "Element name 'servo', id 0, line 2"
            )
        return cls.installed.from_xml_string("<mujoco/>")


def test_an_attribute_that_a_release_has_for_other_actuators_is_left_out(
    tmp_path, monkeypatch
):
    (tmp_path / "made").mkdir()
    model = tmp_path / "scene.xml"
    servo = '<general name="servo" joint="hinge" input="pos" gainprm="80"/>'
    text = f"<mujoco><actuator>\n{servo}\n</actuator></mujoco>"
    model.write_text(text)
    monkeypatch.setattr(worker.mujoco, "MjModel", OfMuJoCo3)
    _, dropped = worker.without_unknown(model, tmp_path / "made")
    assert dropped == ['actuator input="pos"']
