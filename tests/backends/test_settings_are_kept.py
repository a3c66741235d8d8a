"""Settings are read back from the engine: one that it clamps or ignores is an error that names both values."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

import gauge_envs.backends.mujoco as mujoco_backend
from gauge_envs.backends import backend
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.settings import check_kept, put
from gauge_envs.errors import BackendError, ParameterError
from gauge_envs.scene import Contact, Motion, Plane, Pose, RigidBody, Scene, Sphere


def _ball(**contact: float) -> Scene:
    ball = RigidBody(
        name="ball",
        shape=Sphere(radius_m=0.03),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(0, 0, 0.03)),
        mass_kg=0.1,
    )
    ground = RigidBody(
        name="ground",
        shape=Plane(),
        motion=Motion.FIXED,
        pose=Pose(position_m=(0, 0, 0)),
        mass_kg=0.0,
    )
    touch: dict[str, Any] = {"friction": 0.5, "restitution": 0.0} | contact
    return Scene(
        bodies=(ball, ground),
        contacts=(Contact(first=("ball",), second=("ground",), **touch),),
        duration_s=1,
    )


class _Clamping:
    """An object of an engine that takes at most 1 and keeps another name as it is."""

    step = 0.0

    def __setattr__(self, name: str, value: float) -> None:
        object.__setattr__(self, name, min(value, 1.0) if name == "step" else 7)


def test_a_clamped_value_names_what_was_asked_and_what_is_in_force() -> None:
    put("Engine", _Clamping(), step=0.5)
    with pytest.raises(
        BackendError, match=r"'step': 2.0 was asked and 1.0 is in force"
    ):
        put("Engine", _Clamping(), step=2.0)


def test_an_ignored_value_is_an_error() -> None:
    with pytest.raises(BackendError, match="'count': 3 was asked and 7 is in force"):
        put("Engine", _Clamping(), count=3)


def test_rounding_to_single_precision_is_none() -> None:
    check_kept(
        "Engine",
        {"a": 0.1, "b": "Newton", "c": True},
        {"a": 0.10000000149011612, "b": "Newton", "c": True},
    )
    with pytest.raises(BackendError, match="'b'"):
        check_kept("Engine", {"b": "Newton"}, SimpleNamespace(b="PGS"))


@pytest.mark.parametrize(
    ("engine", "module", "settings"),
    [
        ("rapier", "rapier3d", {"max_linear_velocity_m_per_s": 1e39}),
        pytest.param("newton", "newton", {"impratio": 1e-20}, marks=pytest.mark.slow),
    ],
)
def test_values_that_engines_clamp_are_refused(
    engine: str, module: str, settings: dict[str, Any]
) -> None:
    pytest.importorskip(module)
    with pytest.raises(BackendError, match="the engine clamps or ignores it"):
        backend(engine).build(_ball(), settings).close()


def test_an_option_that_does_not_reach_mujoco_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    built = mujoco_backend.build_model

    def faulty(*arguments: Any) -> Any:
        spec, model, parts = built(*arguments)
        model.opt.impratio = 1.0
        return spec, model, parts

    monkeypatch.setattr(mujoco_backend, "build_model", faulty)
    with pytest.raises(
        BackendError, match=r"'impratio': 10.0 was asked and 1.0 is in force"
    ):
        backend("mujoco").build(_ball())


def test_a_parameter_that_does_not_reach_pybullet_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("pybullet")
    from gauge_envs.backends.pybullet.world import BulletWorld

    call = BulletWorld.call

    def faulty(self: Any, name: str, *arguments: Any, **named: Any) -> Any:
        return call(
            self,
            name,
            *arguments,
            **{key: value for key, value in named.items() if key != "rollingFriction"},
        )

    monkeypatch.setattr(BulletWorld, "call", faulty)
    with pytest.raises(BackendError, match="PyBullet setting 'rollingFriction'"):
        backend("pybullet").build(_ball(rolling_m=0.001)).close()


@pytest.mark.parametrize(
    ("field", "words"),
    [("torsion_m", "torsional friction"), ("rolling_m", "rolling friction")],
)
def test_an_engine_without_it_declines_in_words(field: str, words: str) -> None:
    scene = _ball(**{field: 0.001})
    assert scene_support(backend("mujoco"), scene)
    (reason,) = scene_support(backend("rapier"), scene).missing
    assert (
        reason
        == f"'ball' and 'ground' touch with {words}, which this backend does not build"
    )


def test_torsion_needs_friction() -> None:
    with pytest.raises(ParameterError, match="without sliding friction"):
        _ball(friction=0.0, torsion_m=0.001)
