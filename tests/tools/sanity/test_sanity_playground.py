"""Tasks of MuJoCo Playground by name: from a package of the same structure, and from the real one where installed."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import mujoco
import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.model import CapacityLimits
from gauge_envs.tools.sanity.robot.contact_capacity import contact_capacity
from gauge_envs.tools.sanity.stacks import configuration, dialect
from gauge_envs.tools.sanity.stacks.playground import packaged_model, playground_task, playground_tasks

IS_INSTALLED = find_spec("mujoco_playground") is not None

INIT = """
import functools, jax
from mujoco_playground._src.{suite} import dog
_envs = {{{envs}}}
"""

CORE = """
from etils import epath
ROOT_PATH = epath.Path(__file__).parent
MENAGERIE_PATH = ROOT_PATH.parent / "external_deps" / "mujoco_menagerie"
def update_assets(assets, path, glob="*"):
    for f in epath.Path(path).glob(glob):
        assets[f.name] = f.read_bytes()
class MjxEnv:
    def __init__(self, config, config_overrides=None):
        self._config = config.lock()
        if config_overrides:
            self._config.update_from_flattened_dict(config_overrides)
        self._sim_dt = config.sim_dt
    @property
    def sim_dt(self):
        return self._sim_dt
"""

DOG = """
import jax, mujoco
from ml_collections import config_dict
from mujoco_playground._src import mjx_env
XML = mjx_env.ROOT_PATH / "locomotion" / "xmls" / "dog.xml"

def get_assets():
    assets = {}
    mjx_env.update_assets(assets, mjx_env.MENAGERIE_PATH / "dog" / "assets")
    return assets

def default_config():
    return config_dict.create(ctrl_dt=0.02, sim_dt=0.004, impl="warp", naconmax=4 * 512, njmax=40)

class Walk(mjx_env.MjxEnv):
    def __init__(self, task="flat", config=default_config(), config_overrides=None):
        if task.startswith("tight"):
            config.njmax = 12
        if task.startswith("jax"):
            config.impl = "jax"
        super().__init__(config, config_overrides)
        self._xml_path = XML.as_posix()
        self._mj_model = mujoco.MjModel.from_xml_string(XML.read_text(), get_assets())
        self._mj_model.opt.timestep = self.sim_dt
        self._mj_model.opt.ccd_iterations = 20
"""

PARAMETERS = """
from ml_collections import config_dict
def brax_ppo_config(env_name, impl=None):
    config = config_dict.create(num_envs=256)
    if env_name == "DogWalk":
        config.num_envs = 512
    return config
"""

MODEL = """<mujoco model="dog"><include file="legs.xml"/>
  <option iterations="1" ls_iterations="5" timestep="0.003"/>
  <asset><mesh name="hull" file="../../menagerie/dog/hull.stl"/><mesh file="{mesh}"/></asset>
  <worldbody><geom name="floor" type="plane" size="0 0 .01" contype="1" conaffinity="0" priority="1" friction=".6"/>
    <body name="trunk" pos="0 0 .11"><freejoint/><inertial pos="0 0 0" mass="5" diaginertia=".1 .1 .1"/>
      <geom type="mesh" mesh="hull" contype="0" conaffinity="0"/>
      <geom class="foot" name="a" pos=".2 .1 -.1"/><geom class="foot" name="b" pos=".2 -.1 -.1"/>
      <geom class="foot" name="c" pos="-.2 .1 -.1"/><geom class="foot" name="d" pos="-.2 -.1 -.1"/></body></worldbody>
</mujoco>"""

LEGS = """<mujoco><default><default class="foot"><geom size=".02" contype="0" conaffinity="1" solimp=".9 .95 .023"/>
</default></default></mujoco>"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with the structure of MuJoCo Playground, which cannot be imported."""
    folder = tmp_path / "mujoco_playground"
    dog = '"DogWalk": dog.Walk, "DogTight": functools.partial(dog.Walk, task="tight"), "DogOnJax": functools.partial('
    files = {
        "__init__.py": "raise ImportError('no JAX')",
        "_src/mjx_env.py": CORE,
        "_src/dm_control_suite/__init__.py": "_envs = {}",
        "_src/manipulation/__init__.py": "_envs = {}",
        "_src/locomotion/__init__.py": INIT.format(suite="locomotion", envs=dog + 'dog.Walk, task="jax")'),
        "_src/locomotion/dog.py": DOG,
        "_src/locomotion/xmls/dog.xml": MODEL.format(mesh="cover.obj"),
        "_src/locomotion/xmls/legs.xml": LEGS,
        "config/locomotion_params.py": PARAMETERS,
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return folder


def test_a_task_is_read_from_its_source(package: Path) -> None:
    task = playground_task("playground:DogWalk")
    read = configuration("playground:DogWalk")
    assert task.world_count == 512
    assert read.capacity is not None
    assert read.capacity.limits == CapacityLimits(njmax=40, naconmax=2048, worlds=512)
    options = {name: read.settings[name] for name in ("timestep_s", "iterations", "ls_iterations", "ccd_iterations")}
    assert options == {"timestep_s": 0.004, "iterations": 1, "ls_iterations": 5, "ccd_iterations": 20}
    # The floor has priority, so the feet's solimp does not count.
    assert read.settings["contact_solimp"] == [0.9, 0.95, 0.001, 0.5, 2.0]
    assert (read.frame_skip, read.language, read.is_model) == (5, "playground", True)
    assert [group.geoms for group in read.contact_groups] == ["floor with a, b, c and d"]
    assert "jax" not in sys.modules
    assert "mujoco_playground" not in sys.modules


def test_missing_meshes_are_named_and_do_not_change_constants(package: Path) -> None:
    read = configuration("playground:DogWalk")
    note = next(note for note in read.notes if "not here" in note)
    assert "hull.stl, cover.obj" in note and "no colliding geom has one" in note
    assets = package / "external_deps" / "mujoco_menagerie" / "dog" / "assets"
    assets.mkdir(parents=True)
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4"
    (assets / "cover.obj").write_text(corners)
    again = configuration("playground:DogWalk")
    assert "(hull.stl)" in next(note for note in again.notes if "not here" in note)
    assert again.settings == read.settings


def test_a_colliding_substitute_is_found_and_not_counted(package: Path) -> None:
    file = package / "_src/locomotion/xmls/dog.xml"
    file.write_text(file.read_text().replace('mesh="hull" contype="0" conaffinity="0"', 'mesh="hull" name="hull"'))
    packaged = packaged_model(file)
    assert [packaged.model.geom(geom).name for geom in packaged.missing_geoms] == ["hull"]
    capacity = configuration("playground:DogWalk").capacity
    assert capacity is not None and capacity.need is None
    assert capacity.reason == "the shape of 1 colliding geoms is not known here"


def test_a_missing_include_declines(package: Path) -> None:
    (package / "_src/locomotion/xmls/legs.xml").unlink()
    with pytest.raises(TargetError, match=r"dog.xml includes legs.xml, which is not in the package: start the env"):
        configuration("playground:DogWalk")


def test_names_that_do_not_exist(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TargetError, match="has no task 'DogRun'; it has DogWalk, DogTight, DogOnJax"):
        configuration("playground:DogRun")
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(package.parent)])
    if not IS_INSTALLED:
        with pytest.raises(TargetError, match="not installed here: pip install --no-deps playground is enough"):
            configuration("playground:DogWalk")


def test_too_few_constraint_rows_are_wrong_and_named(package: Path) -> None:
    report = check("playground:DogTight", only=["contact-capacity"])
    row = report.rows[0]
    # Four feet with four rows each.
    assert (row.configured, row.verdict.value, report.worst.value) == (4.0, "wrong", "wrong")
    assert row.cause is not None and row.cause.settings == ("njmax",)
    assert row.cause.line.startswith('config_overrides={"njmax": 20}: its model needs 16 constraint rows in a motion')
    assert report.cure is not None and report.cure.line == 'config_overrides={"njmax": 20}: the one flag goes'
    fits = check("playground:DogWalk", only=["contact-capacity"]).rows[0]
    assert (fits.configured, fits.verdict.value) == (0.0, "inside")
    assert "needs 16 constraint rows" in fits.remark and "njmax is 40" in fits.remark


def test_implementations_without_limits_have_no_such_row(package: Path) -> None:
    assert configuration("playground:DogOnJax").capacity is None
    assert check("playground:DogOnJax", only=["contact-capacity", "gravity"]).rows[0].phenomenon == "gravity"
    row = check("mujoco", only=["contact-capacity"]).rows[0]
    assert (row.verdict.value, row.remark) == ("declined", "the target states no limit of its memory for contacts")


def test_contacts_of_all_worlds_are_judged_by_their_mean(package: Path) -> None:
    robot = configuration("playground:DogWalk").robot
    assert robot is not None
    model = robot.model
    need = contact_capacity(model, CapacityLimits(njmax=None, naconmax=8, worlds=4))
    assert need.need is not None and need.need.contacts == 4
    assert need.missing_rows == 0
    assert need.missing_contacts == pytest.approx(need.need.mean_contacts - 2.0)
    enough = contact_capacity(model, CapacityLimits(naconmax=16, worlds=4))
    assert enough.missing_contacts == 0.0
    assert contact_capacity(model, CapacityLimits()).need is None


def test_height_fields_are_not_counted() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1" elevation="0 0 0 0"/></asset>
        <worldbody><geom type="hfield" hfield="h"/><body pos="0 0 1"><freejoint/><geom size=".1"/></body></worldbody>
        </mujoco>"""
    )
    assert "height field" in contact_capacity(model, CapacityLimits(njmax=1)).reason


def test_changes_are_written_as_overrides_and_mjcf() -> None:
    playground = dialect("playground")
    changes = {"timestep_s": 0.002, "njmax": 50, "cone": "elliptic"}
    assert (
        playground.paste_text(changes)
        == 'config_overrides={"sim_dt": 0.002, "njmax": 50} and <option cone="elliptic"/>'
    )
    assert playground.assignment("iterations", 4) == 'iterations="4"'
    assert playground.value_text("timestep_s", 0.004) == "0.004"


@pytest.mark.skipif(not IS_INSTALLED, reason="MuJoCo Playground is not installed")
class TestInstalled:
    """The package itself, 0.2.0 or later."""

    @pytest.mark.slow
    def test_every_task_resolves_or_is_declined_with_the_reason(self) -> None:
        declined = {}
        for name in playground_tasks():
            try:
                read = configuration(f"playground:{name}")
            except TargetError as error:
                declined[name] = str(error)
            else:
                assert read.settings["timestep_s"] == playground_task(name).config["sim_dt"], name
        assert len(playground_tasks()) > 40
        assert all("is not in the package" in reason for reason in declined.values()), declined

    @pytest.mark.parametrize(
        ("name", "expected"),
        [
            ("Go1JoystickFlatTerrain", (0.004, 1, 5, "pyramidal")),
            ("SpotFlatTerrainJoystick", (0.004, 1, 5, "pyramidal")),
            ("G1JoystickFlatTerrain", (0.002, 3, 5, "pyramidal")),
            ("WalkerWalk", (0.0025, 2, 5, "pyramidal")),
            ("CheetahRun", (0.01, 4, 8, "pyramidal")),
            ("CartpoleBalance", (0.01, 1, 4, "pyramidal")),
        ],
    )
    def test_options(self, name: str, expected: tuple[float, int, int, str]) -> None:
        read = configuration(f"playground:{name}")
        assert tuple(read.settings[key] for key in ("timestep_s", "iterations", "ls_iterations", "cone")) == expected

    def test_a_reacher_has_no_place_for_its_joint_limit(self) -> None:
        row = check("playground:ReacherEasy", only=["contact-capacity"]).rows[0]
        assert (row.configured, row.verdict.value) == (1.0, "wrong")
