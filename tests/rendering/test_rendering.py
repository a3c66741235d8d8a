"""Pictures, on machines with and without OpenGL."""

from dataclasses import replace
from types import SimpleNamespace

import gymnasium
import mujoco
import numpy as np
import pytest
from opengl import needs_opengl, pixels_of
from places import RIGID, ROOT
from programs import printed
from scipy.spatial import ConvexHull

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.errors import RenderError
from gauge_envs.rendering import renderer
from gauge_envs.rendering.camera import experiment_view
from gauge_envs.rendering.renderer import DEBIAN_PACKAGES, SceneRenderer
from gauge_envs.rendering.skin import Skin

FIRST_OF_EACH_KIND = tuple({name.rpartition("-")[0]: name for name in RIGID}.values())


@needs_opengl
@pytest.mark.parametrize("name", FIRST_OF_EACH_KIND[::3])
def test_picture_shows_the_moving_body(name):
    env = gymnasium.make(
        f"GAUGE/{name}", render_mode="rgb_array", width=160, height=120
    )
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (120, 160, 3)
    assert first.dtype == np.uint8
    rollout = env.unwrapped.rollout
    far = {
        body: np.array([0.0, 0.0, -50.0, 1.0, 0.0, 0.0, 0.0])
        for body in rollout.poses()
    }
    without = env.unwrapped._pictures.draw(
        rollout.experiment, {}, poses=far, nodes_m={}
    )
    assert (np.abs(first.astype(int) - without).max(axis=2) > 25).sum() > 40
    env.close()


@needs_opengl
def test_triton_is_loaded_before_the_first_picture(tmp_path, monkeypatch):
    """LLVM of triton crashes after LLVM of Mesa: with EGL, `render` and then PPO ended in a segmentation fault."""
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


@pytest.mark.parametrize("system", ["darwin", "win32"])
def test_macos_and_windows_draw_with_the_context_that_mujoco_chooses(
    monkeypatch, system
):
    imported = []
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(renderer, "sys", SimpleNamespace(platform=system))
    monkeypatch.setattr(renderer, "import_module", imported.append)
    with pytest.raises(RenderError, match="no off-screen OpenGL"):
        renderer._graphics_context(40, 30)
    assert imported == ["mujoco.gl_context"]


@needs_opengl
# Gymnasium repeats the error as warnings.
@pytest.mark.filterwarnings("ignore:.*ERROR:UserWarning")
def test_rendering_in_a_fork_raises_an_error_and_does_not_hang():
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


def grid(*edges):
    """Return the points of a grid, shape [point_count, 3]."""
    return np.stack(np.meshgrid(*edges, indexing="ij"), -1).reshape(-1, 3)


def block_nodes_m(foam, counts):
    """Return the nodes of a block on a grid [m], shape [node_count, 3]."""
    edges = zip(foam.shape.size_m, counts, strict=True)
    axes = [np.linspace(-0.5 * edge, 0.5 * edge, count) for edge, count in edges]
    return foam.pose.to_world(grid(*axes))


@needs_opengl
def test_deformable_bodies_are_drawn_where_their_nodes_are():
    experiment = load_experiment("TextileFlinging-satin")
    cloth = experiment.scene.deformables[0]
    edge = np.linspace(-0.5, 0.5, 11)
    rest_m = cloth.pose.to_world(grid(edge, edge, [0.0]) * [*cloth.size_m, 0.0])
    renderer = SceneRenderer(
        experiment.scene,
        {cloth.name: rest_m},
        160,
        120,
        view=experiment_view(experiment),
        materials={cloth.name: "satin"},
    )

    def middle_row(nodes_m):
        picture = renderer.picture({}, {cloth.name: nodes_m}).astype(int)
        terracotta = picture[..., 0] - picture[..., 2] > 60
        assert terracotta.sum() > 500
        return np.nonzero(terracotta)[0].mean()

    assert middle_row(rest_m - [0.0, 0.0, 0.1]) > middle_row(rest_m) + 3
    renderer.close()


@pytest.mark.parametrize("is_irregular", [False, True])
def test_surface_of_a_block_is_closed_with_outward_normals(is_irregular):
    foam = load_experiment("FoamTwisting-soft").scene.deformables[0]
    nodes_m = block_nodes_m(foam, (4, 4, 9))
    volume_m3 = foam.shape.volume_m3
    if is_irregular:
        nodes_m = np.random.default_rng(0).normal(size=(200, 3))
        volume_m3 = ConvexHull(nodes_m).volume
    corners_m = foam.pose.to_body(nodes_m)[Skin(foam, nodes_m).faces]
    # Divergence theorem: the volume inside a closed surface with outward normals.
    across = np.cross(corners_m[:, 1], corners_m[:, 2])
    assert (corners_m[:, 0] * across).sum() / 6.0 == pytest.approx(volume_m3, rel=1e-6)


def surface(body, rest_m, nodes_m):
    """Return vertices and normals of the surface that MuJoCo draws, in the world frame, shape [n, 3] each."""
    spec = mujoco.MjSpec()
    spec.add_material(name="foam")
    skin = Skin(body, rest_m)
    skin.add(spec, "foam")
    model = spec.compile()
    skin.move(model, nodes_m)
    drawing = mujoco.MjvScene(model, maxgeom=10)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    option, camera = mujoco.MjvOption(), mujoco.MjvCamera()
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, option, None, camera, everything, drawing)
    return drawing.skinvert.reshape(-1, 3), drawing.skinnormal.reshape(-1, 3)


@pytest.mark.parametrize(("thickness_m", "half_m"), [(4e-3, 2e-3), (1e-4, 8e-4)])
def test_a_sheet_has_two_sides_half_its_thickness_apart_from_its_nodes(
    thickness_m: float, half_m: float
) -> None:
    """On a rolled sheet the normals are radii, so the vertices are on two cylinders, one per node on each."""
    cloth = load_experiment("TextileFlinging-satin").scene.deformables[0]
    cloth = replace(cloth, thickness_m=thickness_m)
    edge = np.linspace(-0.5, 0.5, 21)
    flat_m = grid(edge, edge, [0.0])
    rolled_m = np.column_stack(
        [np.sin(flat_m[:, 0]), flat_m[:, 1], np.cos(flat_m[:, 0])]
    )
    vertices_m, normals = surface(cloth, cloth.pose.to_world(flat_m), rolled_m)
    inner = np.abs(vertices_m[:, 0]) < 0.4
    offsets_m = np.hypot(vertices_m[inner, 0], vertices_m[inner, 2]) - 1.0
    assert np.abs(offsets_m) == pytest.approx(half_m, rel=0.01)
    assert (offsets_m > 0.0).sum() == (offsets_m < 0.0).sum() > 100
    outward = (normals[inner] * vertices_m[inner] * [1.0, 0.0, 1.0]).sum(axis=1)
    assert (np.sign(outward) == np.sign(offsets_m)).all()


def start_picture(name):
    """Return a picture of a start, and a function that returns its colours at points [m], shape [n, 3]."""
    env = GaugeEnv(name, render_mode="rgb_array", width=320, height=240)
    env.reset(seed=0)
    picture = env.render()
    env.close()
    view = experiment_view(env.experiment)

    def colors_at(points_m):
        columns, rows = pixels_of(view, points_m, width=320, height=240).T.astype(int)
        return picture[rows, columns].astype(int)

    return picture, colors_at, env.experiment.scene


@needs_opengl
def test_bodies_have_the_colour_of_their_material():
    colors = {}
    for material in ("wood", "plastic", "metal"):
        _, colors_at, scene = start_picture(f"SlopeSlider-1-{material}")
        top_m = np.add([scene.body("cube").pose.position_m], [0.0, 0.0, 0.025])
        colors[material] = colors_at(top_m)[0]
    assert colors["wood"][0] - colors["wood"][2] > 50
    assert colors["plastic"].max() < 90
    assert np.ptp(colors["metal"]) < 40
    assert colors["metal"].min() > 120
