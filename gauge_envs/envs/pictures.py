"""Pictures of an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray

if TYPE_CHECKING:
    from gauge_envs.envs.rollout import Rollout
    from gauge_envs.rendering.overlay import Overlay
    from gauge_envs.rendering.renderer import SceneRenderer
    from gauge_envs.rendering.window import Window

RENDER_MODES = ("human", "rgb_array", "depth_array", "rgbd_tuple")
"""Render modes of the environments besides None."""
WORLDS_RENDER_MODES = RENDER_MODES[1:]
"""Render modes of environments with many worlds; a window shows only one scene."""

Picture = NDArray[np.uint8]
"""Red, green and blue of each pixel, shape [height, width, 3]."""
Depth = NDArray[np.float32]
"""Distance of each pixel's point from the camera plane [m], shape [height, width]."""
Rendered = Picture | Depth | tuple[Picture, Depth]
"""Result of `render` with `rgb_array`, `depth_array` and `rgbd_tuple`."""


class Pictures:
    """Renderer of the scene of an environment; it is created at the first picture.

    Args:
        render_mode: None or one of the modes.
        width: Picture width [pixels].
        height: Picture height [pixels].
        camera: Entries that replace those of the scene's camera, as `{"azimuth_deg": 90.0}`: the fields of
            `gauge_envs.rendering.camera.View`.
        has_overlay: Whether pictures have an overlay.
        modes: Render modes of the environment.

    Raises:
        ParameterError: The environment has no such render mode.
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
            )
        self.render_mode = render_mode
        self.has_overlay = has_overlay
        self._size = (width or 640, height or 480)
        self._camera = camera or {}
        self._renderer: SceneRenderer | None = None
        self._window: Window | None = None

    def draw(
        self,
        experiment: Experiment,
        rest_nodes_m: Mapping[str, FloatArray],
        *,
        band: Band | None = None,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None = None,
    ) -> Rendered | None:
        """Return a picture of a scene in the form of the render mode; draw it in the window with `human`.

        Args:
            experiment: The experiment; scene, materials and camera stay those of the first call until `close`.
            rest_nodes_m: Nodes of each deformable body at the start [m], shape [node_count, 3].
            band: Its reference, which the camera also shows, or None.
            poses: Position [m] and quaternion w x y z of each rigid body that moves, shape [7].
            nodes_m: Current nodes of each deformable body [m], shape [node_count, 3].
            overlay: Overlay on the scene, or None.
        """
        if self._window is not None and not self._window.is_open:
            return None
        if self._renderer is None:
            self._renderer = self._new_renderer(experiment, rest_nodes_m, band)
        if self._window is not None:
            self._renderer.show(self._window, poses, nodes_m, overlay)
            return None
        if self.render_mode == "depth_array":
            return self._renderer.depth_m(poses, nodes_m)
        picture = self._renderer.picture(poses, nodes_m, overlay)
        if self.render_mode == "rgbd_tuple":
            return picture, self._renderer.depth_m(poses, nodes_m)
        return picture

    def _new_renderer(
        self,
        experiment: Experiment,
        rest_nodes_m: Mapping[str, FloatArray],
        band: Band | None,
    ) -> SceneRenderer:
        """Return a new renderer, with a window if the render mode is `human`."""
        from gauge_envs.rendering.camera import View, experiment_view
        from gauge_envs.rendering.reference_path import reference_path
        from gauge_envs.rendering.renderer import SceneRenderer
        from gauge_envs.rendering.window import Window

        width, height = self._size
        reference = reference_path(experiment, band)
        places_m = None if reference is None else reference.places_m
        view = experiment_view(experiment, aspect=width / height, places_m=places_m)
        view = View(**{**view.model_dump(), **self._camera})
        if self.render_mode == "human" and self._window is None:
            self._window = Window(width, height, experiment.id, view)
        return SceneRenderer(
            experiment.scene,
            rest_nodes_m,
            width,
            height,
            view=view,
            materials=experiment.materials,
            window=self._window,
        )

    def free(self) -> None:
        """Free the renderer; the next picture creates another one in the same window."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def close(self) -> None:
        """Free the renderer, and close the window."""
        self.free()
        if self._window is not None:
            self._window.close()
            self._window = None


def rollout_picture(
    pictures: Pictures,
    rollout: Rollout,
    bands: Sequence[Band | None],
    world: int = 0,
) -> Rendered | None:
    """Return a picture of a world in the form of the render mode, with an overlay if the pictures have one.

    Args:
        pictures: Renderer; camera and shapes stay those of the first call until it is closed.
        rollout: The episodes, which have begun.
        bands: Reference of each world, or None; the camera shows the first one.
        world: Number of the world.
    """
    overlay = None
    if pictures.has_overlay:
        from gauge_envs.rendering.overlay import tracked_overlay

        trajectory = rollout.recording.trajectory(world)
        overlay = tracked_overlay(
            rollout.experiment,
            bands[world],
            time_s=float(trajectory.times_s[-1]),
            samples=trajectory.samples,
            markers_m=trajectory.markers_m[-1],
        )
    return pictures.draw(
        rollout.experiment,
        rollout.rest_nodes_m,
        band=bands[0],
        poses=rollout.poses(world),
        nodes_m=rollout.nodes_m(world),
        overlay=overlay,
    )
