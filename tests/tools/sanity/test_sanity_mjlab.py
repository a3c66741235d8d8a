"""Tasks of mjlab: from a package of the same structure, its dumped configuration, and the real one where installed."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.stacks import configuration, dialect
from gauge_envs.tools.sanity.stacks.mjlab import mjlab_configuration, mjlab_tasks

IS_INSTALLED = find_spec("mjlab") is not None

PACKAGE = {
    "__init__.py": "from pathlib import Path\nimport torch\nPATH: Path = Path(__file__).parent\nraise ImportError",
    "cfg.py": """
from dataclasses import dataclass, field
@dataclass
class MujocoCfg:
    timestep: float = 0.002
    integrator: str = "implicitfast"
    cone: str = "pyramidal"
    iterations: int = 100
    disableflags: tuple = ()
@dataclass(kw_only=True)
class SimulationCfg:
    nconmax: int | None = None
    njmax: int | None = None
    mujoco: MujocoCfg = field(default_factory=MujocoCfg)
@dataclass
class CollisionCfg:
    geom_names_expr: tuple
    contype: int
    conaffinity: int
    condim: dict
    priority: dict
    solref: tuple | None = None
    disable_other_geoms: bool = True
@dataclass
class ActuatorCfg:
    delay_max_lag: int = 0
@dataclass
class ArticulationCfg:
    actuators: tuple = ()
@dataclass
class EntityCfg:
    spec_fn: object = None
    collisions: tuple = ()
    articulation: object = None
@dataclass
class TermCfg:
    func: object = None
    delay_max_lag: int = 0
@dataclass
class SceneCfg:
    terrain: object = None
    entities: dict = field(default_factory=dict)
@dataclass
class EnvCfg:
    decimation: int
    scene: SceneCfg
    sim: SimulationCfg = field(default_factory=SimulationCfg)
    observations: dict = field(default_factory=dict)
    rewards: dict = field(default_factory=dict)
""",
    "robots/__init__.py": "",
    "robots/dog.py": """
import mujoco
from mjlab import PATH
from mjlab.cfg import ActuatorCfg, ArticulationCfg, CollisionCfg, EntityCfg
def get_spec():
    return mujoco.MjSpec.from_file(str(PATH / "robots" / "dog.xml"))
FULL = CollisionCfg(geom_names_expr=(r".*_collision",), contype=1, conaffinity=1,
    condim={r"^foot\\d_collision$": 6, ".*": 1}, priority={r"^foot\\d_collision$": 1, ".*": 0}, solref=(0.01, 1))
def get_dog():
    return EntityCfg(spec_fn=get_spec, collisions=(FULL,), articulation=ArticulationCfg((ActuatorCfg(3),)))
""",
    "robots/dog.xml": """<mujoco><worldbody><body name="trunk" pos="0 0 .3"><freejoint/>
<geom name="trunk_collision" type="box" size=".2 .1 .05"/><geom name="shell" size=".1" contype="1"/>
<geom name="foot1_collision" size=".02" pos="0 0 -.2"/></body></worldbody>
<keyframe><key name="home" qpos="0 0 .22 1 0 0 0"/></keyframe></mujoco>""",
    "tasks/__init__.py": "",
    "tasks/walk/__init__.py": """
from mjlab.tasks.registry import register_mjlab_task
from .cfgs import rough, flat
register_mjlab_task(task_id="Mjlab-Walk-Rough-Dog", env_cfg=rough(), play_env_cfg=rough(play=True))
register_mjlab_task(task_id="Mjlab-Walk-Flat-Dog", env_cfg=flat(), play_env_cfg=flat(play=True))
""",
    "tasks/walk/cfgs.py": """
from mjlab.cfg import EnvCfg, MujocoCfg, SceneCfg, SimulationCfg, TermCfg
from mjlab.robots.dog import get_dog
class Terrain:
    terrain_type: str = "generator"
class upright:
    pass
def rough(play=False):
    cfg = EnvCfg(decimation=4, scene=SceneCfg(terrain=Terrain()), sim=SimulationCfg(nconmax=35, njmax=1500,
        mujoco=MujocoCfg(timestep=0.005, iterations=10)))
    cfg.scene.entities = {"robot": get_dog()}
    cfg.observations = {"actor": {"terms": {"gyro": TermCfg(delay_max_lag=2), "joints": TermCfg()}}}
    cfg.rewards = {"upright": TermCfg(func=upright)}
    return cfg
def flat(play=False):
    cfg = rough(play=play)
    cfg.sim.njmax = 3
    cfg.sim.mujoco.cone = "elliptic"
    cfg.scene.terrain.terrain_type = "plane"
    return cfg
""",
}

ENV_YAML = """decimation: 4
scene:
  entities:
    robot:
      collisions: !!python/tuple
      - conaffinity: 1
        condim: {'.*': 3}
        contype: 1
        geom_names_expr: !!python/tuple ['.*_collision']
        priority: 0
        solref: !!python/tuple [0.03, 1]
      spec_fn: !!python/name:mjlab.robots.dog.get_spec ''
  terrain:
    terrain_type: plane
sim:
  broadphase: null
  mujoco:
    cone: pyramidal
    disableflags: !!python/tuple [eulerdamp]
    gravity: !!python/tuple [0.0, 0.0, -9.81]
    integrator: euler
    iterations: 10
    ls_iterations: 20
    timestep: 0.005
  njmax: 300
viewer: !!python/object/apply:os.system ['touch was_run']
events: {f: !!python/object:mjlab.events.Event {x: 1}}
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with the structure of mjlab, which cannot be imported."""
    for name, text in PACKAGE.items():
        path = tmp_path / "mjlab" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "mjlab"


def test_a_task_is_read_from_its_source(package: Path) -> None:
    assert mjlab_tasks() == ("Mjlab-Walk-Flat-Dog", "Mjlab-Walk-Rough-Dog")
    read = configuration("mjlab:Mjlab-Walk-Flat-Dog")
    options = {name: read.settings[name] for name in ("timestep_s", "iterations", "integrator", "cone")}
    assert options == {"timestep_s": 0.005, "iterations": 10, "integrator": "implicitfast", "cone": "elliptic"}
    assert (read.frame_skip, read.language) == (4, "mjlab")
    used = {group.geoms: group.constants for group in read.contact_groups if group.is_used}
    assert set(used) == {"terrain with robot/trunk_collision", "terrain with robot/foot1_collision"}
    foot = used["terrain with robot/foot1_collision"]
    # The foot has priority; the trunk is mixed with the terrain. The shell does not collide.
    assert (foot["condim"], foot["solref"]) == (6, [0.01, 1.0])
    assert used["terrain with robot/trunk_collision"]["solref"] == [0.015, 1.0]
    # Two steps of the environment, of 20 ms, and three of the engine.
    assert read.robot.delay_s == pytest.approx(2 * 0.02 + 3 * 0.005)
    assert "mjlab" not in sys.modules
    assert "torch" not in sys.modules


def test_limits_are_those_of_one_world(package: Path) -> None:
    row = check("mjlab:Mjlab-Walk-Flat-Dog", only=["contact-capacity"]).rows[0]
    assert row.verdict.value == "wrong"
    assert row.cause is not None and row.cause.line.startswith("SimulationCfg(njmax=")
    rough = check("mjlab:Mjlab-Walk-Rough-Dog", only=["contact-capacity"]).rows[0]
    assert (rough.verdict.value, rough.remark) == ("declined", "its scene is not complete here")
    assert any("a plane stands for the terrain" in note for note in configuration("mjlab:Mjlab-Walk-Rough-Dog").notes)


def test_the_file_of_a_training_run(package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(ENV_YAML)
    monkeypatch.chdir(tmp_path)
    read = configuration(path)
    options = {name: read.settings[name] for name in ("timestep_s", "iterations", "ls_iterations", "integrator")}
    assert options == {"timestep_s": 0.005, "iterations": 10, "ls_iterations": 20, "integrator": "Euler"}
    assert read.settings["eulerdamp"] is False
    assert read.settings["contact_solref"] == [0.025, 1.0]
    assert read.capacity is not None and read.capacity.limits.njmax == 300
    assert not (tmp_path / "was_run").exists()
    assert read.robot is not None and read.robot.model.opt.timestep == 0.005
    assert read.trains_on == "mujoco_warp"


def test_a_robot_that_is_not_here_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(ENV_YAML.replace("mjlab.robots.dog", "elsewhere.dog"))
    read = configuration(path)
    assert any(note.startswith("left out: robot") for note in read.notes)
    assert read.settings["contact_solref"] == [0.02, 1.0]
    assert read.capacity is not None and read.capacity.need is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("timestep: 0.005", "timestep: fast", "sim.mujoco.timestep is 'fast', and a number is expected"),
        ("iterations: 10", "iterations: 1.5", "sim.mujoco.iterations is 1.5, and a whole number is expected"),
        ("cone: pyramidal", "cone: round", "sim.mujoco.cone is 'round': choose one of pyramidal, elliptic"),
        ("[eulerdamp]", "[magic]", "'magic' is no flag of MuJoCo"),
        ("'.*_collision'", "'(.*)+x'", "is too long or repeats a group"),
        ("'.*_collision'", "'['", "is not valid"),
        ("viewer: ", "viewer: [", "is no YAML"),
        ("njmax: 300", "njmax: yes", "sim.njmax is True, and a number is expected"),
        ("[0.0, 0.0, -9.81]", "[0.0, [0.0], -9.81]", "sim.mujoco.gravity is a list, and a number is expected"),
        (
            "iterations: 10",
            f"iterations: {2**63}",
            "iterations is 9223372036854775808, which MuJoCo does not",
        ),
        ("contype: 1", "contype: -0.5", "contype is -0.5, which MuJoCo does not take"),
        ("[0.03, 1]", "[a, 1]", "solref is ('a', 1), which MuJoCo does not take"),
        ("collisions: !!python/tuple", "collisions: 3\n      x: !!python/tuple", "collisions is 3, and a list"),
        ("spec_fn:", "articulation: {actuators: 3}\n      spec_fn:", "articulation.actuators is 3, and a list"),
    ],
)
def test_files_that_cannot_be_read(package: Path, tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "env.yaml"
    assert old in ENV_YAML
    path.write_text(ENV_YAML.replace(old, new))
    with pytest.raises(TargetError, match=re.escape(message)):
        configuration(path)


@dataclass
class Simulation:
    """An imitation of mjlab's class in this process."""

    njmax: int = 5
    nconmax: int | None = None
    mujoco: dict[str, float] = field(default_factory=lambda: {"timestep": 0.004, "iterations": 7})


@dataclass
class Task:
    """An imitation of mjlab's class in this process."""

    sim: Simulation = field(default_factory=Simulation)
    decimation: int = 3


def test_a_configuration_in_this_process() -> None:
    read = configuration(Task())  # type: ignore[arg-type]
    assert (read.settings["timestep_s"], read.settings["iterations"], read.frame_skip) == (0.004, 7, 3)


def test_names_that_do_not_exist(package: Path) -> None:
    with pytest.raises(TargetError, match="has no task 'Walk'; it has Mjlab-Walk-Flat-Dog, Mjlab-Walk-Rough-Dog"):
        configuration("mjlab:Walk")
    with pytest.raises(TargetError, match="x: the file is a list, and a table is expected"):
        mjlab_configuration([], name="x", source="x")  # type: ignore[arg-type]


def test_changes_are_written_as_configuration_classes() -> None:
    mjlab = dialect("mjlab")
    changes = {"njmax": 50, "cone": "elliptic", "timestep_s": 0.002, "contact_solref": (0.004, 1.0)}
    assert mjlab.paste_text(changes, geoms="terrain with foot") == (
        'SimulationCfg(njmax=50, mujoco=MujocoCfg(cone="elliptic", timestep=0.002)) and '
        "CollisionCfg(solref=(0.004, 1)) for terrain with foot"
    )
    assert mjlab.assignment("integrator", "Euler") == 'integrator="euler"'
    assert mjlab.assignment("eulerdamp", False) == 'disableflags=("eulerdamp",)'
    assert mjlab.gravity_text((0.0, 0.0, -9.80665)) == "SimulationCfg(mujoco=MujocoCfg(gravity=(0, 0, -9.81)))"


@pytest.mark.skipif(not IS_INSTALLED, reason="mjlab is not installed")
class TestInstalled:
    """The package itself, 1.6.0 or later."""

    @pytest.mark.slow
    def test_every_task_resolves(self) -> None:
        for name in mjlab_tasks():
            read = configuration(f"mjlab:{name}")
            assert read.contact_groups, name
        assert len(mjlab_tasks()) >= 10

    def test_options_of_the_go1(self) -> None:
        read = configuration("mjlab:Mjlab-Velocity-Flat-Unitree-Go1")
        names = ("timestep_s", "iterations", "ls_iterations", "cone", "impratio")
        assert tuple(read.settings[name] for name in names) == (0.005, 10, 20, "elliptic", 10.0)
        feet = next(group for group in read.contact_groups if "FR_foot_collision" in group.geoms and group.is_used)
        assert (feet.constants["condim"], feet.constants["solref"]) == (6, [0.01, 1.0])
