"""Pictures, on machines with and without OpenGL."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from opengl import needs_opengl
from places import RIGID, ROOT
from programs import printed

from gauge_envs import load_experiment
from gauge_envs.errors import EpisodeError, RenderError
from gauge_envs.rendering.renderer import DEBIAN_PACKAGES, SceneRenderer
from gauge_envs.rendering.skin import Skin

ONE_EACH = tuple({name.rpartition("-")[0]: name for name in RIGID}.values())


@needs_opengl
@pytest.mark.parametrize("name", ONE_EACH[::3])
def test_picture_shows_the_moving_body(name):
    env = gymnasium.make(
        f"GAUGE/{name}", render_mode="rgb_array", width=160, height=120
    )
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (120, 160, 3)
    assert first.dtype == np.uint8
    episode = env.unwrapped.episode
    far = {
        body: np.array([0.0, 0.0, -50.0, 1.0, 0.0, 0.0, 0.0])
        for body in episode.poses()
    }
    without = env.unwrapped._pictures.draw(
        episode.experiment, {}, poses=far, nodes_m={}
    )
    assert (np.abs(first.astype(int) - without).max(axis=2) > 25).sum() > 40
    env.close()


@needs_opengl
def test_pictures_change_with_the_motion_and_repeat_after_reset():
    env = gymnasium.make(
        "GAUGE/SlopeSlider-2-wood", render_mode="rgb_array", width=160, height=120
    )
    env.reset(seed=0)
    first = env.render()
    for _ in range(15):
        env.step(0)
    assert np.abs(env.render().astype(int) - first).max() > 60
    env.reset(seed=0)
    # Software rasterizers round a pixel now and then by one level.
    assert np.abs(env.render().astype(int) - first).max() <= 2


@needs_opengl
def test_triton_is_loaded_before_the_first_picture(tmp_path, monkeypatch):
    """Its LLVM crashes after that of Mesa: with EGL, `render` and then PPO ended in a segmentation fault."""
    (tmp_path / "triton.py").write_text(
        "import sys\nassert 'mujoco.egl' not in sys.modules\n"
    )
    code = (
        "import sys, gymnasium, gauge_envs\n"
        "env = gymnasium.make('GAUGE/SlopeSlider-2-wood', render_mode='rgb_array', width=16, height=12)\n"
        "env.reset()\nassert 'triton' not in sys.modules\nenv.render()\nassert 'triton' in sys.modules\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    printed("-c", code)


@needs_opengl
def test_rendering_does_not_change_the_physics():
    trajectories = []
    for mode in (None, "rgb_array"):
        env = gymnasium.make("GAUGE/NonsmoothContact-1-wood", render_mode=mode)
        env.reset(seed=0)
        for _ in range(10):
            env.step(0)
            env.render() if mode else None
        trajectories.append(env.unwrapped.trajectory().samples)
    assert np.array_equal(*trajectories)


@needs_opengl
def test_render_before_reset():
    env = gymnasium.make("GAUGE/SlopeSlider-2-wood", render_mode="rgb_array").unwrapped
    with pytest.raises(EpisodeError, match="reset"):
        env.render()


def test_missing_opengl_names_the_packages():
    script = (
        "import ctypes.util; ctypes.util.find_library = lambda name: None\n"
        "import gymnasium, gauge_envs\n"
        "env = gymnasium.make('GAUGE/SlopeSlider-2-wood', render_mode='rgb_array').unwrapped\n"
        "env.reset(seed=0)\n"
        "try:\n    env.render()\n"
        "except gauge_envs.GaugeError as error:\n    print(type(error).__name__, error)\n"
    )
    shown = printed("-c", script, env={})
    assert shown.startswith("RenderError")
    assert DEBIAN_PACKAGES in shown


@needs_opengl
# Gymnasium repeats the error as warnings.
@pytest.mark.filterwarnings("ignore:.*ERROR:UserWarning")
def test_fork_of_a_process_that_has_drawn_says_so_and_does_not_hang():
    make = {"render_mode": "rgb_array", "width": 40, "height": 30}
    env = gymnasium.make("GAUGE/BouncingBall-rubber", **make)
    env.reset(seed=0)
    env.render()
    envs = gymnasium.make_vec(
        "GAUGE/BouncingBall-rubber",
        num_envs=1,
        vectorization_mode="async",
        vector_kwargs={"context": "fork"},
        **make,
    )
    envs.reset(seed=0)
    envs.call_async("render")
    try:
        with pytest.raises(RenderError, match="'context': 'spawn'"):
            envs.call_wait(timeout=20)
    finally:
        envs.close(terminate=True)
        env.close()


@needs_opengl
def test_deformable_bodies_are_drawn_where_their_nodes_are():
    scene = load_experiment("TextileFlinging-satin").scene
    cloth = scene.deformables[0]
    edge = np.linspace(-0.5, 0.5, 11)
    grid = np.stack(
        np.meshgrid(
            edge * cloth.size_m[0], edge * cloth.size_m[1], [0.0], indexing="ij"
        ),
        -1,
    )
    rest = cloth.pose.to_world(grid.reshape(-1, 3))
    renderer = SceneRenderer(
        scene, {cloth.name: rest}, 160, 120, materials={cloth.name: "satin"}
    )

    def terracotta(nodes):
        picture = renderer.picture({}, {cloth.name: nodes}).astype(int)
        return picture[..., 0] - picture[..., 2] > 60

    here, lowered = terracotta(rest), terracotta(rest - [0.0, 0.0, 0.1])
    renderer.close()
    assert here.sum() > 500
    rows = [np.flatnonzero(mask.any(axis=1)).mean() for mask in (here, lowered)]
    assert rows[1] > rows[0] + 3


def test_surface_of_a_solid_is_closed_and_turned_outward():
    foam = load_experiment("FoamTwisting-soft").scene.deformables[0]
    axes = [
        np.linspace(-0.5 * edge, 0.5 * edge, count)
        for edge, count in zip(foam.shape.size_m, (4, 4, 9), strict=True)
    ]
    nodes = foam.pose.to_world(
        np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    )
    corners = foam.pose.to_body(nodes)[Skin(foam, nodes).faces]
    # Divergence theorem: the volume inside a closed surface that is turned outward.
    volume = (
        np.einsum(
            "ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])
        ).sum()
        / 6.0
    )
    assert volume == pytest.approx(foam.shape.volume_m3, rel=1e-6)


def test_sides_of_a_block_are_flat_patches_with_sharp_edges():
    foam = load_experiment("FoamTwisting-soft").scene.deformables[0]
    axes = [
        np.linspace(-0.5 * edge, 0.5 * edge, count)
        for edge, count in zip(foam.shape.size_m, (3, 4, 7), strict=True)
    ]
    nodes = foam.pose.to_world(
        np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    )
    _, normals = Skin(foam, nodes)._surface(nodes)
    local = foam.pose.rotation.apply(normals, inverse=True)
    assert np.abs(local).max(axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize(("thickness_m", "half_m"), [(4e-3, 2e-3), (1e-4, 8e-4)])
def test_a_sheet_has_two_sides_half_its_thickness_apart_from_its_nodes(
    thickness_m: float, half_m: float
) -> None:
    """On a rolled sheet a normal is the radius: the vertices are on two cylinders, as many as nodes on each."""
    cloth = load_experiment("TextileFlinging-satin").scene.deformables[0]
    cloth = replace(cloth, thickness_m=thickness_m)
    edge = np.linspace(-0.5, 0.5, 21)
    flat = np.stack(np.meshgrid(edge, edge, [0.0], indexing="ij"), -1).reshape(-1, 3)
    skin = Skin(cloth, cloth.pose.to_world(flat * [*cloth.size_m, 1.0]))
    angles, radius_m = 2.0 * flat[:, 0], 0.1
    rolled = np.column_stack(
        [radius_m * np.sin(angles), flat[:, 1], radius_m * np.cos(angles)]
    )
    vertices, normals = skin._surface(rolled)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    inner = np.abs(vertices[:, 1]) < 0.4
    inner &= np.abs(np.arctan2(vertices[:, 0], vertices[:, 2])) < 0.9
    distances_m = np.hypot(vertices[inner, 0], vertices[inner, 2]) - radius_m
    assert np.sort(np.abs(distances_m)) == pytest.approx(half_m, rel=1e-3)
    assert np.sum(distances_m > 0.0) == np.sum(distances_m < 0.0) > 100
    outward = (normals[inner] * vertices[inner] * [1.0, 0.0, 1.0]).sum(axis=1)
    assert (np.sign(outward) == np.sign(distances_m)).all()


def test_an_irregular_cloud_has_a_closed_surface_too():
    foam = load_experiment("FoamTwisting-soft").scene.deformables[0]
    cloud = (
        np.random.default_rng(0).uniform(-0.5, 0.5, size=(400, 3)) * foam.shape.size_m
    )
    faces = Skin(foam, foam.pose.to_world(cloud)).faces
    edges = np.sort(
        np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [0, 2]]]), axis=1
    )
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
