"""Each stack has one dialect, read and written by one table: what is read of a written change is the change."""

import re
import sys
from collections.abc import Mapping
from importlib import import_module
from math import radians
from types import ModuleType, SimpleNamespace

import mujoco
import numpy as np
import pytest
from mujoco_stacks import (
    CollisionCfg,
    MujocoCfg,
    SimulationCfg,
    install_mjlab,
    mjlab_task,
    playground_env,
)

from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.stacks import STACKS, dialect, genesis
from gauge_envs.tools.sanity.stacks.isaac_gym import isaac_gym_configuration
from gauge_envs.tools.sanity.stacks.isaac_lab import isaac_lab_configuration
from gauge_envs.tools.sanity.stacks.maniskill import maniskill_configuration

FLAGS = dict.fromkeys(
    ("warmstart", "refsafe", "eulerdamp", "nativeccd", "multiccd", "island"),
    (False, True),
)

MUJOCO = {
    "timestep_s": (0.0025, 0.004),
    "integrator": ("Euler", "implicitfast", "RK4"),
    "cone": ("elliptic", "pyramidal"),
    "solver": ("PGS", "CG", "Newton"),
    **dict.fromkeys(
        ("impratio", "tolerance", "ls_tolerance", "noslip_tolerance"), (0.0125, 40.0)
    ),
    **dict.fromkeys(("ccd_tolerance", "sleep_tolerance"), (0.0125, 40.0)),
    **dict.fromkeys(
        ("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"), (7, 110)
    ),
    **FLAGS,
    **dict.fromkeys(("diagexact", "sleep", "speculative"), (True, False)),
    "contact_solref": ((0.004, 1.5), (-300.0, -20.0)),
    "contact_solimp": ((0.8, 0.9, 0.002, 0.4, 3.0), (0.95, 0.99, 0.01, 0.5, 2.0)),
    "contact_margin_m": (0.01, 0.002),
    "contact_gap_m": (0.003, 0.005),
    "condim": (4, 6),
    "njmax": (40, 90),
    "naconmax": (300, 800),
}
"""Values of the settings of MuJoCo's stacks."""

PHYSX = {
    "timestep_s": (0.0025, 0.004),
    "solver": ("PGS", "TGS"),
    **dict.fromkeys(("position_iterations", "velocity_iterations"), (3, 17)),
    **dict.fromkeys(
        ("continuous_detection", "enhanced_determinism", "persistent_manifolds"),
        (True, False),
    ),
    "friction_every_iteration": (True, False),
    "tolerance_length_m": (0.1, 2.0),
    "rest_offset_m": (0.001, 0.002),
    "max_angular_velocity_rad_per_s": (radians(300.0), radians(500.0)),
}
"""Values of the settings of stacks on PhysX; all others are numbers."""

NUMBERS = (0.0125, 0.5)

GENESIS = {
    "precision": (32, 64),
    "timestep_s": (0.0025, 0.004),
    "integrator": ("Euler", "implicitfast", "approximate_implicitfast"),
    "constraint_solver": ("CG", "Newton"),
    "friction_cone": ("elliptic", "pyramidal"),
    "contact_resolution": ("signorini", "convex"),
    **dict.fromkeys(
        ("iterations", "line_search_iterations", "noslip_iterations"), (7, 110)
    ),
    **dict.fromkeys(("multi_contact", "box_box_detection", "gjk"), (False, True)),
    "sustained_timeconst_s": (0.03, 0.05),
    "sustained_impedance": ((0.8, 0.9, 0.002), (0.95, 0.99, 0.01)),
}
"""Values of the settings of Genesis; all others are numbers."""


class Tables(SimpleNamespace):
    """Nested tables whose entries are attributes, which come into being where they are named."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        setattr(self, name, Tables())
        return getattr(self, name)

    def plain(self):
        return {
            name: one.plain() if isinstance(one, Tables) else one
            for name, one in vars(self).items()
        }


def merged(first, second):
    """Return nested tables with the entries of others."""
    for name, one in second.items():
        first[name] = (
            merged(first.get(name) or {}, one) if isinstance(one, Mapping) else one
        )
    return first


def found(read):
    """Return settings, and limits of contacts by the same names."""
    limits = None if read.capacity is None else read.capacity.limits
    return {
        **read.settings,
        **(
            {}
            if limits is None
            else {"njmax": limits.njmax, "naconmax": limits.naconmax}
        ),
    }


# --- one stack each: from a snippet to what is read of it -------------------------------------------------------------


def of_mjcf(text, _):
    parts = text.replace(" and ", "\n")
    # Margins and gaps of two geoms add up, so the plane has none of its own.
    plane, ball = (
        '<geom type="plane" size="1 1 1" margin="0" gap="0"/>',
        '<body><freejoint/><geom size=".1"/></body>',
    )
    return found(
        configuration(
            mujoco.MjModel.from_xml_string(
                f"<mujoco>{parts}<worldbody>{plane}{ball}</worldbody></mujoco>"
            )
        )
    )


def of_playground(text, _):
    if not text.startswith("config_overrides="):
        return of_mjcf(text, _)
    names = {"sim_dt": "timestep_s", "njmax": "njmax", "naconmax": "naconmax"}
    overrides = eval(text.removeprefix("config_overrides="))
    limits = playground_limits(overrides)
    return {
        names[key]: limits.get(names[key], value) for key, value in overrides.items()
    }


def playground_limits(overrides):
    """Return the limits that are read of an environment of Playground with such overrides."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    read = found(configuration(playground_env(model, impl="warp", **overrides)))
    return {name: read[name] for name in ("njmax", "naconmax")}


def of_mjlab(text, _):
    names = {
        "SimulationCfg": SimulationCfg,
        "MujocoCfg": MujocoCfg,
        "CollisionCfg": CollisionCfg,
    }
    parts = [eval(part, names) for part in text.split(" and ")]
    sim = next((part for part in parts if isinstance(part, SimulationCfg)), None)
    collision = next((part for part in parts if isinstance(part, CollisionCfg)), None)
    return found(configuration(mjlab_task(sim, collision)))


def of_isaac_lab(text, _):
    made = Tables()
    exec(
        text,
        {"self": made, "sim_utils": SimpleNamespace(CollisionPropertiesCfg=Tables)},
    )
    place = "physics" if "sim.physics" in text else "physx"
    base = {
        "sim": {"dt": 0.005, place: {"bounce_threshold_velocity": 0.5}},
        "scene": {"robot": {"spawn": {}}},
    }
    return found(
        isaac_lab_configuration(merged(base, made.plain()), name="task", source="test")
    )


def of_isaac_gym(text, _):
    names = {
        "sim": Tables(dt=0.005, substeps=2, physx=Tables(num_position_iterations=4)),
        "asset": Tables(),
    }
    exec(text, names)
    cfg = {key: names[key].plain() for key in ("sim", "asset")}
    return found(isaac_gym_configuration(cfg, name="task", source="test"))


def of_maniskill(text, _):
    fields = eval(text, {"SimConfig": dict, "SceneConfig": dict})
    return found(
        maniskill_configuration(
            merged({"sim_freq": 100}, fields), name="task", source="test"
        )
    )


class Constants(np.ndarray):
    """Constants of two geoms, in the form of a tensor."""

    def cpu(self):
        return self

    def numpy(self):
        return np.asarray(self)


class Geom(SimpleNamespace):
    """A geom, which is a key of tables."""

    __hash__ = object.__hash__


class Names:
    """Constants of Genesis: `gs.integrator.Euler` is the text `Euler`."""

    def __getattr__(self, name):
        return name


def of_genesis(text, _):
    given = {"precision": "32"}
    options = SimpleNamespace(
        SimOptions=lambda **sim: {"sim": sim},
        RigidOptions=lambda **rigid: {"rigid": rigid},
    )
    gs = SimpleNamespace(init=lambda **init: given.update(init), options=options)
    for name in (
        "integrator",
        "constraint_solver",
        "friction_cone",
        "contact_resolution",
    ):
        setattr(gs, name, Names())
    constants = np.array([[0.02, 1.0, 0.9, 0.95, 0.001, 0.5, 2.0]] * 2).view(Constants)
    links = [
        SimpleNamespace(is_fixed=True, name="ground"),
        SimpleNamespace(is_fixed=False, name="ball"),
    ]
    geoms = [
        Geom(contype=1, conaffinity=1, link=link, idx=place)
        for place, link in enumerate(links)
    ]
    solver = SimpleNamespace(
        geoms=geoms,
        get_sol_params=lambda: constants,
        set_sol_params=lambda values: None,
    )
    kind = type("Scene", (), {"__module__": "genesis.engine.scene"})
    scene = kind()
    scene.is_built, scene.rigid_solver = True, solver
    made = {
        "sim": {"dt": 0.01, "substeps": 1, "gravity": (0.0, 0.0, -9.81)},
        "rigid": {},
    }
    for part in re.split(r" and (?=gs\.|sim_options|rigid_options|sol_params)", text):
        if part.startswith("sol_params"):
            exec(part, {"scene": scene, "torch": SimpleNamespace(tensor=np.array)})
        else:
            value = eval(re.sub(r"^\w+=", "", part), {"gs": gs})
            merged(made, value or {})
    scene.options = SimpleNamespace(
        sim=SimpleNamespace(**made["sim"]),
        rigid=SimpleNamespace(
            **{**dict.fromkeys(genesis.SCENE_OPTIONS), **made["rigid"]}
        ),
    )
    size = SimpleNamespace(itemsize=8 if given["precision"] == "64" else 4)
    sys.modules["genesis"].tc_float = size
    return found(configuration(scene))


def of_toml(text, folder):
    file = folder / "settings.toml"
    file.write_text(
        'backend = "mujoco"\n[settings]\n' + re.sub(r", (?=\w+ = )", "\n", text),
    )
    return dict(configuration(file).settings)


READINGS = {
    "mjcf": (of_mjcf, MUJOCO),
    "playground": (of_playground, MUJOCO),
    "mjlab": (of_mjlab, MUJOCO),
    "isaac_lab": (of_isaac_lab, PHYSX),
    "isaac_lab_3": (of_isaac_lab, PHYSX),
    "isaac_gym": (of_isaac_gym, PHYSX),
    "maniskill": (of_maniskill, PHYSX),
    "genesis": (of_genesis, GENESIS),
    "toml": (
        of_toml,
        {
            name: values
            for name, values in MUJOCO.items()
            if name not in ("njmax", "naconmax")
        },
    ),
}
"""What reads a snippet of each dialect, and values of its settings; Newton's has a test with Newton's own objects."""

NOT_READ = {"link_linear_damping_per_s", "angular_damping_per_s"}
"""Settings that ManiSkill changes by a call on each link: no SimConfig states them."""


def cases():
    for name, (_, values) in READINGS.items():
        known = dialect(name)
        stated = [one.name for one in known.settings] or list(values)
        for setting in dict.fromkeys(stated):
            if name != "maniskill" or setting not in NOT_READ:
                yield name, setting


def test_every_dialect_is_read_here_or_with_its_engine():
    modules = [
        import_module(f"gauge_envs.tools.sanity.stacks.{name}") for name in STACKS
    ]
    names = {one.name for module in modules for one in getattr(module, "DIALECTS", ())}
    assert names == {*READINGS, "newton"}


@pytest.mark.parametrize(("name", "setting"), list(cases()))
def test_reading_what_a_dialect_writes_gives_the_setting_back(
    name, setting, tmp_path, monkeypatch
):
    install_mjlab(monkeypatch)
    monkeypatch.setitem(sys.modules, "genesis", ModuleType("genesis"))
    monkeypatch.setattr(genesis, "check_settings", lambda *_: None)
    reading, known = READINGS[name]
    written = dialect(name)
    assert written.writes(setting)
    for value in known.get(setting, NUMBERS):
        read = reading(written.paste_text({setting: value}), tmp_path)[setting]
        assert (
            read == value
            if isinstance(value, str)
            else read == pytest.approx(value, rel=1e-6)
        )


def test_changes_in_the_words_of_each_stack(approved):
    """All settings of a stack at once, one that is left out, one without a key, and gravity."""
    lines = []
    for name in (*READINGS, "newton"):
        written = dialect(name)
        known = READINGS.get(name, (None, MUJOCO))[1]
        stated = [one.name for one in written.settings] or list(known)
        changes = {setting: known.get(setting, NUMBERS)[0] for setting in stated}
        lines += [
            f"=== {name} ===",
            written.paste_text(changes),
            written.assignment("o_friction", None),
            written.assignment("unknown", (1.0, 0.25)),
            written.value_text(stated[0], changes[stated[0]]),
            written.value_text(stated[0], None),
            written.gravity_text((0.0, 0.0, -9.80665)),
            f"states hinges: {written.writes('hinges')}",
        ]
    approved("sanity/dialects", "\n".join(lines))
