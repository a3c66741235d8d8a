"""Settings are read back from the engine: one that it clamps or ignores is an error that names both values."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

import gauge_envs.backends.mujoco as mujoco_backend
from gauge_envs.backends import backend
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.settings import check_kept, put
from gauge_envs.errors import BackendError, ParameterError
from gauge_envs.scene import Scene
from gauge_envs.tools.bench.parts import ball, contact, ground


def _ball(**terms):
    touch = replace(contact("ball", "ground", friction=0.5), **terms)
    bodies = (ball("ball", (0, 0, 0.03)), ground())
    return Scene(bodies=bodies, contacts=(touch,), duration_s=1)


class _Clamping:
    """An object of an engine that takes at most 1 and keeps another name as it is."""

    step = 0.0

    def __setattr__(self, name, value):
        object.__setattr__(self, name, min(value, 1.0) if name == "step" else 7)


def test_a_clamped_value_names_what_was_asked_and_what_is_in_force():
    put("Engine", _Clamping(), step=0.5)
    with pytest.raises(
        BackendError, match=r"'step': 2.0 was asked and 1.0 is in force"
    ):
        put("Engine", _Clamping(), step=2.0)


def test_an_ignored_value_is_an_error():
    with pytest.raises(BackendError, match="'count': 3 was asked and 7 is in force"):
        put("Engine", _Clamping(), count=3)


def test_rounding_to_single_precision_is_none():
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
def test_values_that_engines_clamp_are_refused(engine, module, settings):
    pytest.importorskip(module)
    with pytest.raises(BackendError, match="the engine clamps or ignores it"):
        backend(engine).build(_ball(), settings).close()


def test_an_option_that_does_not_reach_mujoco_is_an_error(monkeypatch):
    built = mujoco_backend.build_model

    def faulty(*arguments):
        spec, model, parts = built(*arguments)
        model.opt.impratio = 1.0
        return spec, model, parts

    monkeypatch.setattr(mujoco_backend, "build_model", faulty)
    with pytest.raises(
        BackendError, match=r"'impratio': 10.0 was asked and 1.0 is in force"
    ):
        backend("mujoco").build(_ball())


@pytest.mark.parametrize(
    ("field", "words"),
    [("torsion_m", "torsional friction"), ("rolling_m", "rolling friction")],
)
def test_an_engine_without_it_declines_in_words(field, words):
    scene = _ball(**{field: 0.001})
    assert scene_support(backend("mujoco"), scene)
    (reason,) = scene_support(backend("rapier"), scene).missing
    assert (
        reason
        == f"'ball' and 'ground' touch with {words}, which this backend does not build"
    )


def test_torsion_needs_friction():
    with pytest.raises(ParameterError, match="without sliding friction"):
        _ball(friction=0.0, torsion_m=0.001)
