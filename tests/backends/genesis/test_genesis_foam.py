"""Genesis's soft bodies, by finite elements and by material points: elasticity, grips, contact, repeatability."""

from dataclasses import replace

import numpy as np
import pytest
from laws_at_rest import ratio_at_rest

from gauge_envs import load_experiment
from gauge_envs.scene import Attachment

pytest.importorskip("genesis", reason="extra 'genesis' is not installed")

from gauge_envs.backends import backend
from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.foam import fitted_voxel_m
from gauge_envs.backends.genesis.presets import settings_for, unsupported_deformables
from gauge_envs.backends.genesis.settings import (
    longest_mpm_timestep_s,
    soft_presets,
    sound_time_s,
)
from gauge_envs.backends.shared.attachments import (
    attachments_by_body,
    bonded_soft_bodies,
)
from gauge_envs.backends.shared.soft_rows import SoftRow, linear_weights
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.tools.bench.parts import contact
from gauge_envs.tools.bench.recording import DivergedError, record
from gauge_envs.tools.conformance import Status, run_checks


def soft_row(scene):
    (bodies,) = bonded_soft_bodies(scene)
    return SoftRow.of(bodies, attachments_by_body(scene, bodies))


@pytest.mark.parametrize(
    "preset", ["default", pytest.param("mpm", marks=pytest.mark.slow)]
)
def test_a_bar_has_its_modulus_and_poisson_ratio_and_follows_its_grip(preset):
    settings = {"preset": preset}
    young, poisson = (
        ratio_at_rest("genesis", law, settings)
        for law in ("foam-tension", "foam-poisson")
    )
    assert young == pytest.approx(1.0, rel=0.01)
    assert poisson == pytest.approx(1.0, rel=0.01)
    (grip,) = run_checks("genesis", settings=settings, only=("foam-pinned-face",))
    assert grip.status is Status.PASS


@pytest.mark.slow
def test_a_cube_as_wide_as_the_foam_stays_outside_it():
    scene = load_experiment("FoamBending-soft").scene
    simulation = backend("genesis").build(scene)
    rollout = record(simulation, scene, 0.5)
    simulation.close()
    nodes, lower_m = rollout.nodes_m["foam"], rollout.position("cube")[:, 2] - 0.025
    under = (nodes[0, :, 2] > nodes[0, :, 2].max() - 1e-6) & (
        np.abs(nodes[0, :, 1] - 0.39576) < 0.0255
    )
    assert under.sum() == 25
    gap_m = lower_m[-1] - nodes[-1, under, 2]
    assert nodes[0, under, 2].mean() - lower_m[-1] > 0.005
    assert np.all(np.abs(gap_m - 1e-3) < 4e-4)


def test_blocks_of_a_row_have_their_own_material():
    scene = load_experiment("CantileverBeam-soft").scene
    simulation = backend("genesis").build(scene)
    assert [len(simulation.nodes(f"cube-{number}")[0]) for number in range(1, 5)] == [
        125
    ] * 4
    for _ in range(18):
        simulation.advance(1 / 180)
    lengths = [
        np.ptp(simulation.nodes(f"cube-{number}")[0, :, 1]) for number in range(1, 5)
    ]
    simulation.close()
    assert abs(lengths[1] - 0.05) < 2e-3
    assert all(np.isfinite(lengths))


def test_grid_planes_lie_at_the_faces_of_both_grips():
    row = soft_row(load_experiment("FoamTwisting-soft").scene)
    voxel = fitted_voxel_m([row], 0.0125)
    assert 0.85 * 0.0125 <= voxel <= 1.15 * 0.0125
    for face in (row.low_m[2], row.high_m[2]):
        assert abs(round(face / voxel) * voxel - face) < 0.15 * voxel


def test_the_step_of_material_points_is_a_share_of_the_time_of_sound():
    scene = load_experiment("FoamTwisting-soft").scene
    (body,) = scene.deformables
    density = body.mass_kg / (0.05 * 0.05 * 0.2)
    modulus = body.young_modulus_pa * 0.77 / (1.23 * 0.54)
    assert longest_mpm_timestep_s(body, 0.0125) == pytest.approx(
        0.4 * 0.0125 / np.sqrt(modulus / density), rel=1e-9
    )
    assert soft_presets(scene)["mpm"].timestep_s <= longest_mpm_timestep_s(body, 0.0125)


def test_out_of_the_box_foam_has_the_values_that_genesis_gives_to_a_program_that_states_none():
    options = engine().options
    presets = soft_presets(load_experiment("FoamTwisting-soft").scene)
    one = presets["out_of_box"]
    assert 1 / one.cell_m == pytest.approx(options.MPMOptions().grid_density)
    assert one.cell_m / one.points_per_voxel_edge == pytest.approx(
        options.MPMOptions().particle_size
    )
    assert one.model == engine().materials.MPM.Elastic().model
    assert one.contact_softness_m == engine().materials.Rigid().coup_softness
    # Genesis's default step is longer than the interval, of which each step is a part.
    assert one.timestep_s == one.drive_interval_s < options.SimOptions().dt
    assert (
        one.model_copy(update={"preset": "paper", "timestep_s": 1 / 900})
        == presets["paper"]
    )


@pytest.mark.parametrize(
    "preset", ["out_of_box", pytest.param("paper", marks=pytest.mark.slow)]
)
def test_foam_that_bursts_is_an_error_that_names_the_longest_step(preset):
    scene = load_experiment("FoamTwisting-soft").scene
    simulation = backend("genesis").build(scene, {"preset": preset})
    assert simulation.diverged() == {}
    with pytest.raises(
        DivergedError,
        match=r"'foam' left its grid: explicit MPM is unstable.* set timestep_s to 1/",
    ):
        record(simulation, scene, 0.1)
    simulation.close()


@pytest.mark.slow
def test_the_longest_step_that_the_error_names_holds():
    scene = load_experiment("FoamTwisting-soft").scene
    (body,) = scene.deformables
    voxel_m = fitted_voxel_m([soft_row(scene)], 1 / 64)
    steps = int(np.ceil(1 / 180 / (0.4 * sound_time_s(body, voxel_m))))
    simulation = backend("genesis").build(
        scene, {"preset": "paper", "timestep_s": 1 / 180 / steps}
    )
    record(simulation, scene, 0.1)
    simulation.close()


def test_a_preset_for_other_scenes_is_declined():
    for id, preset, kind in (
        ("Pendulum-metal", "mpm", "soft bodies"),
        ("TextileFlinging-satin", "mpm", "soft bodies"),
        ("FoamTwisting-soft", "impact", "rigid bodies alone"),
    ):
        with pytest.raises(
            UnsupportedSceneError, match=f"preset '{preset}' is for scenes with {kind}"
        ):
            settings_for(load_experiment(id).scene, {"preset": preset})


def test_weights_reproduce_linear_functions():
    generator = np.random.default_rng(0)
    sources, points = (
        generator.uniform(size=(300, 3)),
        generator.uniform(0.2, 0.8, size=(20, 3)),
    )
    nearest, weights = linear_weights(sources, points)
    values = 0.3 + sources @ [1.0, -2.0, 0.5]
    assert np.einsum("pk,pk->p", weights, values[nearest]) == pytest.approx(
        0.3 + points @ [1.0, -2.0, 0.5], abs=1e-9
    )


def test_soft_bodies_that_genesis_cannot_simulate_are_declined():
    for id in ("RopeWinding-rubber", "StickStack-soft"):
        reasons = tuple(unsupported_deformables(load_experiment(id).scene))
        assert any("is a line" in reason for reason in reasons)
    scene = load_experiment("CantileverBeam-soft").scene
    touching = contact("cube-1", "cube-3", friction=0.1)
    reasons = tuple(unsupported_deformables(replace(scene, contacts=(touching,))))
    assert any("'cube-1' may touch 'cube-3'" in reason for reason in reasons)
    (cloth,) = load_experiment("TextileFlinging-satin").scene.deformables
    both = replace(scene, deformables=(*scene.deformables, cloth))
    assert any("is beside cloth" in reason for reason in unsupported_deformables(both))
    apart = replace(
        scene,
        attachments=(
            Attachment(
                deformable="cube-9", region=scene.attachments[0].region, to="base"
            ),
        ),
    )
    assert any(
        "not in the scene" in reason for reason in unsupported_deformables(apart)
    )
