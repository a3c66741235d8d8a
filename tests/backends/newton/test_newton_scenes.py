"""Deformable scenes on Newton through the public contract: what it takes, courses, presets."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment, variants
from gauge_envs.backends import backend
from gauge_envs.backends.newton.settings import settings_for
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import (
    Attachment,
    Box,
    Pose,
    Region,
    Scene,
    SoftBody,
)
from gauge_envs.tools.bench.parts import contact, fixed_box

pytest.importorskip("newton")

GRAVITY_M_PER_S2 = 9.80665


@pytest.fixture
def run(rollout):
    """Environment some frames after its start, with the recorded motion."""
    return lambda name, frames, *, engine="newton", proxy="material", **options: (
        rollout(name, frames=frames, backend=engine, marker_proxy=proxy, **options)[0]
    )


def markers_mm(env):
    """Marker paths, shape [frame_count, marker_count, 3]."""
    return 1e3 * env.trajectory().markers_m


def distance_mm(one, other):
    """Root mean square distance of markers in each frame, shape [frame_count]."""
    return np.sqrt(np.square(one - other).sum(axis=-1).mean(axis=-1))


# --- what is taken and what is declined ------------------------------------------------------------------------------


def test_newton_takes_all_families_but_the_rope_that_rebounds():
    for variant in variants():
        missing = (
            backend("newton").supports(load_experiment(variant.name).scene).missing
        )
        assert bool(missing) == (variant.family == "RopeWinding"), missing
        assert not missing or "no restitution" in "; ".join(missing)


def test_a_declined_experiment_names_a_backend_that_can():
    with pytest.raises(
        UnsupportedSceneError, match=r"no restitution.*backend='mujoco' can"
    ):
        gymnasium.make("GAUGE/RopeWinding-rubber", backend="newton")


# --- courses ---------------------------------------------------------------------------------------------------------


# Variant, frames, least distance that its markers move, and largest distance between both engines [mm].
COURSES = [
    # Both solve the same elasticity, on cells of their own.
    ("FoamStretching-soft", 8, 1.0, 0.05),
    # The meshes are alike and the membranes' small-strain limits too; the rest is a step that is 3 times as short.
    ("TextileFlinging-satin", 15, 100.0, 0.5),
    # Rubber, a hundred times as stiff as the foam, is rigid here and elastic there.
    ("CantileverBeam-soft", 4, 30.0, 0.5),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "frames", "moved_mm", "apart_mm"), COURSES)
def test_bodies_go_as_in_mujoco(name, frames, moved_mm, apart_mm, run):
    paths, theirs = (
        markers_mm(run(name, frames, engine=one)) for one in ("newton", "mujoco")
    )
    assert distance_mm(paths, paths[:1])[-1] > moved_mm
    assert distance_mm(paths, theirs).max() < apart_mm


@pytest.mark.parametrize("proxy", ["node", "material"])
@pytest.mark.parametrize("name", ["FoamStretching-soft", "TextileStretching-satin"])
def test_markers_start_where_they_are_attached(name, proxy, run):
    env = run(name, 1, proxy=proxy)
    published = 1e3 * np.array(env.experiment.scene.markers.positions_m)
    start, after = markers_mm(env)
    reach_mm = 1e-3 if proxy == "material" else 1e3 * np.sqrt(3.0) * 0.5 * 0.025
    assert np.linalg.norm(start - published, axis=1).max() < reach_mm
    moved = np.linalg.norm(after - start, axis=1)
    assert 0.0 < moved.max() < 5.0


# --- beams of foam and rubber ----------------------------------------------------------------------------------------


def falling(name, x_m, young_pa=1e5):
    return SoftBody(
        name=name,
        shape=Box(size_m=(0.05, 0.05, 0.05)),
        pose=Pose(position_m=(x_m, 0.0, 0.03)),
        mass_kg=0.01,
        young_modulus_pa=young_pa,
        poisson_ratio=0.3,
    )


def on_a_slab(*bodies, touching, attachments=()):
    """Blocks 5 mm above a slab that some of them touch."""
    return Scene(
        bodies=(fixed_box("slab", (0.0, 0.0, -0.05), (1.0, 1.0, 0.1)),),
        deformables=bodies,
        attachments=tuple(attachments),
        contacts=(contact(tuple(touching), "slab", friction=0.3),),
        duration_s=1.0,
    )


@pytest.mark.parametrize("worlds", [1, 2])
def test_each_body_collides_with_what_its_contacts_say(worlds):
    scene = on_a_slab(falling("held", 0.0), falling("passing", 0.2), touching=["held"])
    copies = backend("newton").build_worlds(
        scene, worlds, {"preset": "soft_row", "cell_m": 0.025}
    )
    seconds = 0.2
    copies.advance(seconds)
    held, passing = copies.nodes("held"), copies.nodes("passing")
    assert len(held) == len(passing) == worlds
    assert held[:, :, 2].min(axis=1) == pytest.approx(0.0, abs=2e-3)
    # An implicit Euler step falls half a step further each time.
    fall = 0.5 * GRAVITY_M_PER_S2 * seconds * (seconds + 1 / 3600)
    assert 0.03 - passing[:, :, 2].mean(axis=1) == pytest.approx(fall, rel=1e-4)


def test_blocks_of_a_row_collide_on_their_own():
    """A light foam block bonded to a heavy rigid one: whichever may touch the slab holds its end up."""
    foam, rubber = (
        replace(falling("foam", 0.0), mass_kg=0.002),
        replace(falling("rubber", 0.05, 1e7), mass_kg=0.02),
    )
    bond = Attachment(
        deformable="rubber", region=Region(axis="x", side="low"), to="foam"
    )
    lowest_mm = {}
    for touching in ("foam", "rubber", "nothing"):
        scene = on_a_slab(foam, rubber, touching=[touching], attachments=[bond])
        simulation = backend("newton").build(scene, {"cell_m": 0.025})
        assert simulation.settings["preset"] == "soft_row"
        simulation.advance(0.1)
        lowest_mm[touching] = [
            1e3 * float(simulation.nodes(name)[0, :, 2].min())
            for name in ("foam", "rubber")
        ]
    # Both rest on the layer that keeps nodes off what they touch.
    assert lowest_mm["rubber"] == pytest.approx([0.1, 0.1], abs=0.02)
    # The heavy end tips over the edge of the light one, through the slab.
    assert lowest_mm["foam"][0] == pytest.approx(0.1, abs=0.2)
    assert lowest_mm["foam"][1] < -20.0
    assert lowest_mm["nothing"] == pytest.approx(
        [5.0 - 0.5e3 * GRAVITY_M_PER_S2 * 0.1**2] * 2, abs=0.2
    )


@pytest.mark.slow
def test_a_beam_of_foam_and_rubber_swings_at_mujocos_rate(run):
    ours, theirs = (
        run("CantileverBeam-soft", 89, engine=one) for one in ("newton", "mujoco")
    )
    assert ours.rollout.simulation.settings["preset"] == "soft_row"
    assert ours.rollout.simulation.settings["soft_rigid_ratio"] == 50.0
    rates_hz = []
    for env in (ours, theirs):
        height = markers_mm(env)[:, 15, 2]
        crossings = np.flatnonzero(np.diff(np.sign(height - 160.0)))
        times = crossings + (160.0 - height[crossings]) / (
            height[crossings + 1] - height[crossings]
        )
        rates_hz.append(30.0 * (len(times) - 1) / (2.0 * (times[-1] - times[0])))
    assert rates_hz[1] == pytest.approx(2.49, abs=0.01)
    assert rates_hz[0] == pytest.approx(rates_hz[1], rel=0.02)


# --- presets ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_material_points_stretch_as_tetrahedra_do(run):
    points = run("FoamStretching-soft", 2, settings={"preset": "mpm"})
    tetrahedra = run("FoamStretching-soft", 2)
    assert points.rollout.simulation.settings["solver"] == "SolverImplicitMPM"
    paths = markers_mm(points)
    assert distance_mm(paths, paths[:1])[-1] > 0.3
    assert distance_mm(paths, markers_mm(tetrahedra)).max() < 0.05


@pytest.mark.parametrize(
    ("name", "solver", "rate_hz"),
    [
        ("SlopeSlider-2-wood", "SolverMuJoCo", 180),
        ("TextileFlinging-satin", "SolverVBD", 180),
        ("FoamBending-hard", "SolverImplicitMPM", 900),
    ],
)
def test_preset_paper_has_the_solver_and_the_rate_of_the_paper(name, solver, rate_hz):
    settings = settings_for(load_experiment(name).scene, {"preset": "paper"})
    assert (settings.preset, settings.solver) == ("paper", solver)
    assert settings.timestep_s == pytest.approx(1 / rate_hz)
