"""The look of pictures: even light ground with a grid of a stated pitch, materials, no gaps and no flicker."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from opengl import needs_opengl

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, View, experiment_view
from gauge_envs.rendering.materials import LOOKS, USUAL, look_of
from gauge_envs.rendering.renderer import SceneRenderer
from gauge_envs.rendering.skin import Skin
from gauge_envs.rendering.studio import GROUND, grid_pitch_m, studio_model
from gauge_envs.scene import Box, Motion, Plane, SoftBody
from gauge_envs.scene.geometry import vector

SIZE = (320, 240)


def start_picture(name, **arguments):
    """Return a picture of a start, its closed renderer, which states the camera, and the scene."""
    env = GaugeEnv(name)
    env.reset(seed=0)
    scene = env.experiment.scene
    looks = {
        "view": experiment_view(env.experiment),
        "materials": env.experiment.materials,
    } | arguments
    renderer = SceneRenderer(scene, env.episode.rest_nodes_m, *SIZE, **looks)
    picture = renderer.picture(env.episode.poses(), env.episode.nodes_m())
    renderer.close()
    env.close()
    return picture, renderer, scene


def at(picture, renderer, points_m):
    """Return the colours of a picture at points [m], shape [point_count, 3]."""
    columns, rows = renderer.camera.pixels(
        points_m, width=SIZE[0], height=SIZE[1]
    ).T.astype(int)
    return picture[rows, columns].astype(int)


@needs_opengl
def test_ground_is_light_and_meets_the_background_without_a_horizon():
    picture, _, _ = start_picture("BouncingBall-rubber")
    background = 255.0 * np.array(GROUND)
    # Columns beside the ball and its shadow, from sky to ground.
    columns = np.concatenate([picture[:, :60], picture[:, -30:]], axis=1).astype(float)
    assert np.abs(np.median(columns, axis=1) - background).max() <= 4.0
    # Lines of the grid are subtle.
    assert np.abs(columns - background).max() < 40.0
    assert np.abs(picture[-40:, :60] - background).max() > 8.0


@needs_opengl
@pytest.mark.parametrize("height_m", [0.4, 1.0])
def test_the_grid_has_the_stated_pitch(height_m):
    scene = load_experiment("BouncingBall-rubber").scene
    # The ground alone, from straight above.
    scene = replace(
        scene,
        bodies=tuple(body for body in scene.bodies if isinstance(body.shape, Plane)),
        contacts=(),
    )
    ground = scene.bodies[0].pose.position_m
    distance = 0.5 * height_m / np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG))
    view = View(
        target_m=vector(ground),
        distance_m=distance,
        azimuth_deg=90.0,
        elevation_deg=-89.999,
    )
    renderer = SceneRenderer(scene, {}, 600, 600, view=view)
    picture = renderer.picture({}, {}).astype(float)
    renderer.close()
    pitch_px = 600.0 * grid_pitch_m(view) / height_m
    for axis in (0, 1):
        darkness = 255.0 - picture.mean(axis=(axis, 2))
        spectrum = np.abs(np.fft.rfft(darkness - darkness.mean()))
        # The lowest strong frequency is one line for each pitch.
        first = np.flatnonzero(spectrum > 0.5 * spectrum.max())[0]
        assert first == pytest.approx(600.0 / pitch_px, abs=1.0)
    assert grid_pitch_m(view) == (0.025 if height_m < 0.5 else 0.1)


@needs_opengl
@pytest.mark.parametrize("name", ["FoamTwisting-soft", "FoamShearing-hard"])
def test_foam_reaches_its_grips(name):
    picture, renderer, scene = start_picture(name)
    foam = scene.deformables[0]
    size = np.array(foam.shape.size_m)
    # Points of the side that faces the camera, up to both ends, which sit in the grips.
    way = renderer.camera.eye_m - foam.pose.position_m
    axis = int(np.abs(way[:2]).argmax())
    front = np.zeros((41, 3))
    front[:, axis] = 0.5 * size[axis] * np.sign(way[axis])
    front[:, 2] = np.linspace(-0.5, 0.5, 41) * (size[2] - 0.004)
    colours = at(picture, renderer, foam.pose.to_world(front))
    # In a gap the lighter ground or the black grip would show; the shadow of the grip is half as bright at least.
    lit = np.median(colours, axis=0)
    assert (colours < lit + 25).all()
    assert (colours > 0.5 * lit).all()


@needs_opengl
def test_a_cloth_in_the_surface_of_a_table_does_not_flicker():
    experiment = load_experiment("TableclothPulling-wood")
    scene, table = experiment.scene, experiment.scene.body("table")
    cloth = scene.deformables[0]
    edge = np.linspace(-0.5, 0.5, 21)
    grid = np.stack(
        np.meshgrid(
            edge * cloth.size_m[0], edge * cloth.size_m[1], [0.0], indexing="ij"
        ),
        -1,
    ).reshape(-1, 3)
    nodes = cloth.pose.to_world(grid)
    # Exactly in the upper side of the table: without a thickness each pixel would show either of them.
    nodes[:, 2] = table.pose.to_world(table.shape.corners_m)[:, 2].max()
    renderer = SceneRenderer(
        scene, {cloth.name: nodes}, *SIZE, materials=experiment.materials
    )
    away = {
        name: np.array([0.0, 0.0, -50.0, 1.0, 0.0, 0.0, 0.0])
        for name in ("cube", "rod")
    }
    picture = renderer.picture(away, {cloth.name: nodes})
    renderer.close()
    inner = nodes[
        (np.abs(grid) < 0.47 * max(cloth.size_m)).all(axis=1)
        & (np.abs(grid[:, 1]) < 0.47 * cloth.size_m[1])
    ]
    colours = at(picture, renderer, inner)
    # Nylon is green and the table is brown.
    assert (colours[:, 1] > colours[:, 0]).all()


@needs_opengl
def test_cubes_have_the_colour_of_their_material():
    colours = {}
    for material in ("wood", "plastic", "metal"):
        picture, renderer, scene = start_picture(f"SlopeSlider-1-{material}")
        top = np.array([scene.body("cube").pose.position_m]) + np.array(
            [0.0, 0.0, 0.025]
        )
        colours[material] = at(picture, renderer, top)[0]
    assert colours["wood"][0] - colours["wood"][2] > 50
    assert colours["plastic"].max() < 90
    assert np.ptp(colours["metal"]) < 40
    assert colours["metal"].min() > 120


@needs_opengl
def test_a_far_string_is_visible_over_its_whole_length():
    picture, renderer, scene = start_picture("NewtonsCradle-metal")
    joint = scene.joints[2]
    ball = np.array(scene.body(joint.body).pose.position_m)
    places = (
        np.linspace(0.1, 0.85, 30)[:, None] * (ball - joint.anchor_m) + joint.anchor_m
    )
    assert (at(picture, renderer, places).max(axis=1) < 150).all()


@needs_opengl
def test_bodies_cast_a_light_shadow():
    picture, _, _ = start_picture("NonsmoothContact-1-wood")
    grey = (np.ptp(picture.astype(int), axis=2) < 14) & (picture.max(axis=2) < 210)
    assert grey.sum() > 100
    assert picture[grey].min() > 110


def rounded(values: object) -> list[float]:
    """Return four decimals of numbers or truth values."""
    return np.round(np.ravel(values).astype(float), 4).tolist()


def look_words(model: mujoco.MjModel) -> str:
    """Return light, materials and shapes of a model, and mean and scatter of the texels of its textures."""
    lines = [
        f"{name}: {rounded(getattr(owner, name))}"
        for owner, names in (
            (model.vis.headlight, ("ambient", "diffuse", "specular")),
            (model.vis.global_, ("offwidth", "offheight", "fovy")),
            (model.vis.quality, ("shadowsize", "offsamples")),
            (model.vis.map, ("znear", "zfar", "shadowclip", "haze")),
            (model.vis.rgba, ("haze",)),
            (model.stat, ("center", "extent")),
        )
        for name in names
    ]
    for kind, count, names in (
        ("light", model.nlight, "pos dir diffuse specular castshadow"),
        ("mat", model.nmat, "rgba emission specular shininess texrepeat texuniform"),
        ("geom", model.ngeom, "type size rgba matid"),
    ):
        for index in range(count):
            values = {
                name: rounded(getattr(model, f"{kind}_{name}")[index])
                for name in names.split()
            }
            lines.append(f"{kind} {index}: {values}")
    for index in range(model.ntex):
        first, width = model.tex_adr[index], model.tex_width[index]
        texels = model.tex_data[first : first + width * model.tex_height[index] * 3]
        rows = texels.reshape(-1, width, 3).astype(float)
        # Scatter of rows and of columns: a grain is drawn out along one of them.
        along, across = rows.std(axis=1).mean(), rows.std(axis=0).mean()
        words = f"{rows.shape} {rows.mean():.0f} {along:.1f} {across:.1f}"
        lines.append(f"texture {index}: {words} {texels[:6].tolist()}")
    return "\n".join(lines)


@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "FoamTwisting-soft", "TableclothPulling-metal"]
)
def test_the_look_of_a_scene_is_the_approved_one(
    name: str, approved: Callable[[str, str], None]
) -> None:
    experiment = load_experiment(name)
    scene = experiment.scene
    # Foam without what its grips hold, and the corners of a cloth.
    nodes_m = {
        body.name: body.pose.to_world(
            body.shape.corners_m * [1.0, 1.0, 0.8]
            if isinstance(body, SoftBody)
            else Box(size_m=(*body.size_m, 0.0)).corners_m[::2]
        )
        for body in scene.deformables
    }
    skins = [Skin(body, nodes_m[body.name]) for body in scene.deformables]
    view = experiment_view(experiment)
    studio = studio_model(
        scene, skins, nodes_m, experiment.materials, view, width=320, height=240
    )
    approved(f"rendering/{name}", look_words(studio))


def test_materials_are_those_of_the_task_file_or_of_the_variant():
    assert load_experiment("SlopeSlider-2-metal").materials["cube"] == "metal"
    assert load_experiment("SlopeSlider-2-metal").materials["board"] == "wood"
    wall = load_experiment("WallBreaking-wood").materials
    assert wall["ball"] == "metal"
    assert wall["brick-118"] == "wood"
    assert load_experiment("CantileverBeam-soft").materials["cube-2"] == "rubber"


@pytest.mark.parametrize(
    "name",
    [
        "TextileFlinging-leather",
        "FoamTwisting-hard",
        "CubeToss-acrylic",
        "StickStack-soft",
    ],
)
def test_every_material_has_a_look_of_its_own(name):
    experiment = load_experiment(name)
    for body in (*experiment.scene.bodies, *experiment.scene.deformables):
        look = look_of(body, experiment.materials[body.name])
        assert isinstance(getattr(body, "shape", None), Plane) or look in LOOKS.values()
    dynamic = load_experiment("SlopeSlider-2-wood").scene.body("cube")
    assert (
        look_of(dynamic, None)
        == look_of(dynamic, "unobtainium")
        == USUAL[Motion.DYNAMIC]
    )
