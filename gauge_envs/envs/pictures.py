"""The renderer of an environment: it starts with the first picture, and each copy of the environment starts its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.tables import Camera
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray

if TYPE_CHECKING:
    from gauge_envs.envs.rollout import Rollout
    from gauge_envs.rendering.overlay import Overlay
    from gauge_envs.rendering.reference_path import ReferencePath
    from gauge_envs.rendering.renderer import SceneRenderer
    from gauge_envs.rendering.window import Window

RENDER_MODES = ("human", "rgb_array", "depth_array", "rgbd_tuple")
"""Render modes of the environments, apart from None."""
WORLDS_RENDER_MODES = RENDER_MODES[1:]
"""Render modes of environments of many worlds: a window has one scene."""

Picture = NDArray[np.uint8]
"""Red, green and blue of each pixel, shape [height, width, 3]."""
Depth = NDArray[np.float32]
"""Distance of what each pixel shows from the plane of the camera [m], shape [height, width]."""
Rendered = Picture | Depth | tuple[Picture, Depth]
"""What `render` returns with `rgb_array`, `depth_array` and `rgbd_tuple`."""

DEFAULT_SIZE = (640, 480)
"""Width and height of a picture [pixels] where none are given."""
SIZE_LIMIT = 16_384
"""Largest width and height of a picture [pixels], that of common graphics cards."""


class Pictures:
    """Renderer of the scene that an environment simulates.

    Args:
        render_mode: None or one of the modes.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace those of the scene's camera, as `{"azimuth_deg": 90.0}`: the fields of
            `gauge_envs.experiments.tables.Camera`.
        has_overlay: Whether the environment puts an overlay on its pictures.
        modes: Render modes of the environment.

    Raises:
        ParameterError: An argument is wrong, or no picture of the render mode would show it.
    """

    def __init__(
        self,
        render_mode: str | None,
        *,
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        has_overlay: bool = False,
        modes: tuple[str, ...] = RENDER_MODES,
    ) -> None:
        if render_mode not in (None, *modes):
            raise ParameterError(
                f"render_mode {render_mode!r}: choose None or {', '.join(map(repr, modes))}"
                + ("; a window shows one world" if render_mode == "human" else "")
            )
        for name, value in (("width", width), ("height", height)):
            if value is not None and (
                not isinstance(value, int | np.integer)
                or isinstance(value, bool)
                or not 1 <= value <= SIZE_LIMIT
            ):
                raise ParameterError(
                    f"{name} is {value!r}, expected a whole number of pixels from 1 to {SIZE_LIMIT}"
                )
        if not isinstance(has_overlay, bool | np.bool_):
            raise ParameterError(
                f"render_overlay is {has_overlay!r}, expected True or False"
            )
        self.render_mode = render_mode
        self.has_overlay = bool(has_overlay)
        self._size = (width or DEFAULT_SIZE[0], height or DEFAULT_SIZE[1])
        self._camera = _checked_camera(camera)
        if render_mode is None:
            given = {
                "width": width is not None,
                "height": height is not None,
                "camera": camera is not None,
                "render_overlay": has_overlay,
            }
            for name, is_given in given.items():
                if is_given:
                    raise ParameterError(
                        f"{name} without render_mode would change nothing: give one, as render_mode='rgb_array'"
                    )
        if has_overlay and render_mode == "depth_array":
            raise ParameterError(
                "render_overlay with render_mode 'depth_array' would change nothing: the overlay has no depth"
            )
        self._renderer: SceneRenderer | None = None
        self._window: Window | None = None

    def draw(
        self,
        experiment: Experiment,
        rest_nodes_m: Mapping[str, FloatArray],
        *,
        band: Band | None = None,
        reach: ReferencePath | None = None,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None = None,
    ) -> Rendered | None:
        """Return a picture of a scene in the form of the render mode; draw it in the window with `human`.

        Args:
            experiment: The experiment; scene, materials and camera stay those of the first call until `close`.
            rest_nodes_m: For each deformable body its nodes at the start [m], shape [node_count, 3].
            band: Its band, whose places the camera frames too, or None.
            reach: Places that actions bring bodies to, which the camera frames in place of those of the band, or None.
            poses: Position [m] and quaternion w x y z of each rigid body that moves, shape [7].
            nodes_m: Nodes of each deformable body now [m], shape [node_count, 3].
            overlay: What is drawn on top of the scene, or None.
        """
        if self.render_mode == "human" and self._is_window_closed:
            return None
        if self._renderer is None:
            from gauge_envs.rendering.camera import experiment_view, scene_view
            from gauge_envs.rendering.reference_path import reference_path
            from gauge_envs.rendering.renderer import SceneRenderer

            width, height = self._size
            if reach is None:
                reference = reference_path(experiment, band)
                view = experiment_view(
                    experiment, aspect=width / height, reference=reference
                )
            else:
                view = scene_view(experiment.scene, reference=reach)
            view = type(view)(**{**view.model_dump(), **self._camera})
            if self.render_mode == "human" and self._window is None:
                from gauge_envs.rendering.window import Window

                self._window = Window(width, height, experiment.id)
            self._renderer = SceneRenderer(
                experiment.scene,
                rest_nodes_m,
                width,
                height,
                view=view,
                materials=experiment.materials,
                window=self._window,
            )
        if self.render_mode == "human":
            self._renderer.show(poses, nodes_m, overlay)
            return None
        if self.render_mode == "depth_array":
            return self._renderer.depth_m(poses, nodes_m)
        picture = self._renderer.picture(poses, nodes_m, overlay)
        if self.render_mode == "rgbd_tuple":
            return picture, self._renderer.depth_m(poses, nodes_m)
        return picture

    @property
    def _is_window_closed(self) -> bool:
        """Whether a person has closed the window."""
        return self._window is not None and not self._window.is_open

    def free(self) -> None:
        """Free the renderer; the next picture starts another one, in the same window."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def close(self) -> None:
        """Free the renderer, and close the window."""
        self.free()
        if self._window is not None:
            self._window.close()
            self._window = None


def _checked_camera(camera: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the entries of a camera that replace others, or raise an error for what no camera has."""
    if camera is None:
        return {}
    if not isinstance(camera, Mapping):
        raise ParameterError(
            f"camera is {camera!r}, expected a mapping, as {{'azimuth_deg': 90.0}}"
        )
    entries = {
        name: tuple(value) if isinstance(value, list | np.ndarray) else value
        for name, value in camera.items()
    }
    usual: dict[str, Any] = {
        "target_m": (0.0, 0.0, 0.0),
        "distance_m": 1.0,
        "azimuth_deg": 0.0,
        "elevation_deg": 0.0,
    }
    try:
        Camera(**usual | entries)
    except ValueError as error:
        raise ParameterError(
            f"camera {dict(camera)!r}: its entries are target_m (three numbers), distance_m (above 0), azimuth_deg and "
            "elevation_deg"
        ) from error
    return entries


def rollout_picture(
    pictures: Pictures, rollout: Rollout, world: int = 0
) -> Rendered | None:
    """Return a picture of a world in the form of the render mode, with its overlay if the pictures have one.

    Args:
        pictures: Renderer; camera and shapes stay those of the first call until it is closed.
        rollout: The episode, which has begun.
        world: Number of the world.
    """
    return pictures.draw(
        rollout.experiment,
        rollout.rest_nodes_m,
        band=rollout.bands[0],
        poses=rollout.poses(world),
        nodes_m=rollout.nodes_m(world),
        overlay=rollout_overlay(rollout, world) if pictures.has_overlay else None,
    )


def rollout_overlay(rollout: Rollout, world: int = 0) -> Overlay:
    """Return the overlay of a world."""
    from gauge_envs.rendering.overlay import tracked_overlay
    from gauge_envs.rendering.reference_path import reference_path

    trajectory = rollout.trajectory(world)
    experiment = rollout.experiment
    return tracked_overlay(
        experiment,
        reference_path(experiment, rollout.bands[world]),
        time_s=float(trajectory.times_s[-1]),
        samples=trajectory.samples,
        markers_m=trajectory.markers_m[-1],
        poses=rollout.poses(world),
    )
