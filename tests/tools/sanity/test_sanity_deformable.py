"""What the sanity check measures on deformable bodies: readings against closed forms, outcomes of training settings."""

from dataclasses import replace

import numpy as np
import pytest
from sanity_cases import CHEETAH, moved

from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.scene import Rope
from gauge_envs.tools.bench.recording import DeclinedError, DivergedError
from gauge_envs.tools.sanity.measure import Measurements
from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.phenomena import phenomena
from gauge_envs.tools.sanity.scenario import run_scenario

MUJOCO = backend("mujoco")
TIMES_S = np.linspace(0.0, 1.2, 601)


def one(name):
    (found,) = phenomena([name], include_deformables=True)
    return found


def deformable():
    return [
        one
        for one in phenomena(include_deformables=True)
        if one.scenario.scene.deformables
    ]


def read(phenomenon, rollout):
    assert phenomenon.failure is None
    return float(phenomenon.value(rollout))


def markers_m(phenomenon):
    """Markers at rest [m], shape [marker_count, 3]."""
    return np.asarray(phenomenon.scenario.scene.markers.positions_m)


# --- readings of motions that are known ------------------------------------------------------------------------------


def test_sag_is_the_centre_of_the_swing():
    sag = one("cloth-sag")
    rest = markers_m(sag)
    down_m = 1.3e-3 * (1.0 - np.cos(2.0 * np.pi * 16.4 * TIMES_S))
    markers = rest - down_m[:, None, None] * [0.0, 0.0, 1.0]
    assert read(sag, moved(sag.scenario, TIMES_S, markers)) == pytest.approx(
        1.3, rel=0.01
    )


def test_sag_of_a_linear_strip_is_the_law():
    """By summing up the elongations of thin slices, each under the weight below it."""
    sag = one("cloth-sag")
    (cloth,) = sag.scenario.scene.deformables
    rod = sag.scenario.scene.body("rod").pose.position_m[2]
    edges = np.linspace(0.0, rod - markers_m(sag)[:, 2].min(), 100_001)
    middles = 0.5 * (edges[1:] + edges[:-1])
    weight = cloth.areal_density_kg_per_m2 * 9.80665 * (cloth.size_m[0] - middles)
    elongation_m = float(
        np.sum(weight * np.diff(edges)) / cloth.stretch_stiffness_n_per_m
    )
    assert sag.reality.value == pytest.approx(1e3 * elongation_m, rel=1e-3)


def test_fling_reads_the_angle_of_a_rigid_sheet():
    fling = one("fling-lag")
    rest = markers_m(fling)
    rod = np.asarray(fling.scenario.scene.body("rod").pose.position_m)
    angle = np.radians(13.0) * np.sin(np.pi * TIMES_S / 1.2)
    arm = rod[2] - rest[:, 2]
    displacement = np.outer(np.linspace(0.0, -0.6, len(TIMES_S)), [0.0, 1.0, 0.0])
    markers = np.empty((len(TIMES_S), *rest.shape))
    markers[..., 0] = rest[:, 0]
    markers[..., 1] = rod[1] + arm * np.sin(angle)[:, None]
    markers[..., 2] = rod[2] - arm * np.cos(angle)[:, None]
    assert read(
        fling,
        moved(
            fling.scenario, TIMES_S, markers + displacement[:, None], rod=displacement
        ),
    ) == pytest.approx(13.0, abs=0.01)


@pytest.mark.parametrize("name", ["foam-stretch", "foam-compress"])
def test_area_of_a_face_that_grows_alike_in_all_directions(name):
    foam = one(name)
    rest = markers_m(foam)
    markers = rest * np.linspace(1.0, 1.02, len(TIMES_S))[:, None, None]
    assert read(foam, moved(foam.scenario, TIMES_S, markers)) == pytest.approx(
        100.0 * (1.02**2 - 1.0)
    )


@pytest.mark.parametrize("stretch", [0.01, -0.02])
def test_stretch_of_a_rope_that_is_wound(stretch):
    rope = one("rope-length")
    (body,) = rope.scenario.scene.deformables
    assert isinstance(body, Rope)
    turn = np.linspace(0.0, 4.0 * np.pi, 2001)
    helix = np.column_stack([np.cos(turn), np.sin(turn), 0.5 * turn])
    helix *= body.length_m / np.linalg.norm(np.diff(helix, axis=0), axis=1).sum()
    nodes = helix * (1.0 + stretch * np.sin(np.pi * TIMES_S / 1.2))[:, None, None]
    rollout = replace(
        moved(rope.scenario, TIMES_S, np.zeros((0, 0, 3))), nodes_m={"rope": nodes}
    )
    assert read(rope, rollout) == pytest.approx(1e3 * stretch * body.length_m, rel=1e-3)


def test_foot_stays_behind_the_base():
    foot = one("foot-lag")
    rest = markers_m(foot)
    base = np.outer(0.0173 * TIMES_S, [1.0, 0.0, 0.0])
    markers = rest + base[:, None]
    markers[:, rest[:, 2].argmin(), 0] -= np.where(TIMES_S > 0.0, 2.2e-3, 0.0)
    assert read(
        foot, moved(foot.scenario, TIMES_S, markers, base=base)
    ) == pytest.approx(2.2)


# --- reality ---------------------------------------------------------------------------------------------------------


# --- rollouts --------------------------------------------------------------------------------------------------------


def test_refused_settings_are_declined_with_their_reason():
    settings = CHEETAH | {"integrator": "implicitfast"}
    with pytest.raises(DeclinedError, match="set integrator='discrete'"):
        run_scenario(MUJOCO, one("foam-stretch").scenario, settings)
    measured = Measurements(MUJOCO).measure(one("foam-stretch"), settings)
    assert (measured.verdict, measured.value) == (Verdict.DECLINED, None)


@pytest.mark.parametrize("timestep_s", [0.01, 0.002, 1 / 900, 0.001])
@pytest.mark.parametrize(
    "name", ["cloth-carry", "cloth-sag", "foam-stretch", "foot-lag"]
)
def test_explicit_elasticity_diverges_and_is_seen(name, timestep_s):
    """MuJoCo sets back to the start what blows up, and a body at its start may look as if it were right."""
    measured = Measurements(MUJOCO).measure(
        one(name), {"timestep_s": timestep_s, "integrator": "Euler"}
    )
    assert (measured.verdict, measured.value) == (Verdict.WRONG, None)
    assert measured.remark.startswith("diverged: after 0.0")


def test_an_engine_that_raises_has_diverged(monkeypatch):
    def give_up(simulation, seconds):
        raise MemoryError("too many\ncontacts")

    monkeypatch.setattr(SimulationMuJoCo, "advance", give_up)
    with pytest.raises(
        DivergedError,
        match="after 0 s the engine raises MemoryError: too many contacts",
    ):
        run_scenario(MUJOCO, one("foot-lag").scenario, {})


# --- engines ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_preset_raises_no_flag():
    found = {one.id: Measurements(MUJOCO).measure(one, {}) for one in deformable()}
    assert {one.verdict for one in found.values()} == {Verdict.INSIDE}


def test_a_step_as_long_as_the_scene_is_declined():
    """Nothing can be fitted to one sample."""
    with pytest.raises(DeclinedError, match="a step of 2 s is too long for a scene of"):
        run_scenario(MUJOCO, one("creep-wood").scenario, {"timestep_s": 2.0})


def test_a_fall_of_two_samples_has_the_height_of_the_release():
    rollout = run_scenario(
        MUJOCO, one("rebound").scenario, {"timestep_s": 0.15, "drive_interval_s": 0.15}
    )
    assert np.isfinite(one("rebound").value(rollout))
