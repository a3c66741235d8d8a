"""The renderer of an environment: it starts with the first picture, and each copy of the environment starts its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.scene.timing import FRAME_RATE_HZ

if TYPE_CHECKING:
    from gauge_envs.envs.episode import Episode
    from gauge_envs.evaluation.reference_path import ReferencePath
    from gauge_envs.rendering.overlay import Overlay
    from gauge_envs.rendering.renderer import SceneRenderer

RENDER_MODES = ("rgb_array",)
"""Render modes of the environments, apart from None."""

SIZE_LIMIT = 16_384
"""Largest width and height of a picture [pixels], that of common graphics cards."""


class Pictures:
    """Renderer of the scene that an environment simulates.

    Args:
        render_mode: None or `rgb_array`.
        width: Picture width [pixels].
        height: Picture height [pixels].
        has_overlay: Whether the environment puts an overlay on its pictures.
    """

    def __init__(
        self,
        render_mode: str | None,
        *,
        width: int,
        height: int,
        has_overlay: bool = False,
    ) -> None:
        if render_mode not in (None, *RENDER_MODES):
            raise ParameterError(
                f"render_mode {render_mode!r}: choose None or 'rgb_array'"
            )
        for name, value in (("width", width), ("height", height)):
            if (
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
        self._size = (width, height)
        self._renderer: SceneRenderer | None = None

    def draw(
        self,
        experiment: Experiment,
        rest_nodes_m: Mapping[str, NDArray[np.float64]],
        *,
        band: Band | None = None,
        reach: ReferencePath | None = None,
        poses: Mapping[str, NDArray[np.float64]],
        nodes_m: Mapping[str, NDArray[np.float64]],
        overlay: Overlay | None = None,
    ) -> NDArray[np.uint8]:
        """Return a picture of a scene, shape [height, width, 3].

        Args:
            experiment: The experiment; scene, materials and camera stay those of the first call until `close`.
            rest_nodes_m: For each deformable body its nodes at the start [m], shape [node_count, 3].
            band: Its band, whose places the camera frames too, or None.
            reach: Places that actions bring bodies to, which the camera frames in place of those of the band, or None.
            poses: Position [m] and quaternion w x y z of each rigid body that moves, shape [7].
            nodes_m: Nodes of each deformable body now [m], shape [node_count, 3].
            overlay: What is drawn on top of the scene, or None.
        """
        if self._renderer is None:
            from gauge_envs.evaluation.reference_path import reference_path
            from gauge_envs.rendering.camera import experiment_view, scene_view
            from gauge_envs.rendering.renderer import SceneRenderer

            width, height = self._size
            if reach is None:
                reference = reference_path(experiment, band)
                view = experiment_view(
                    experiment, aspect=width / height, reference=reference
                )
            else:
                view = scene_view(experiment.scene, reference=reach)
            self._renderer = SceneRenderer(
                experiment.scene,
                rest_nodes_m,
                width,
                height,
                view=view,
                materials=experiment.materials,
            )
        return self._renderer.picture(poses, nodes_m, overlay)

    def close(self) -> None:
        """Free the renderer; the next picture starts another one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the renderer, whose graphics context neither pickles nor copies."""
        return vars(self) | {"_renderer": None}


def episode_picture(
    pictures: Pictures, episode: Episode, *, drawn_as: Episode
) -> NDArray[np.uint8]:
    """Return a picture of an episode, shape [height, width, 3], with its overlay if the pictures have one.

    Args:
        pictures: Renderer.
        episode: An episode that has begun.
        drawn_as: Episode whose scene states camera and shapes, the same in each call until the renderer is closed.
    """
    return pictures.draw(
        drawn_as.experiment,
        drawn_as.rest_nodes_m,
        band=drawn_as.band,
        poses=episode.poses(),
        nodes_m=episode.nodes_m(),
        overlay=episode_overlay(episode) if pictures.has_overlay else None,
    )


def episode_overlay(episode: Episode) -> Overlay:
    """Return the overlay of an episode that has begun."""
    from gauge_envs.evaluation.reference_path import reference_path
    from gauge_envs.rendering.overlay import tracked_overlay

    trajectory = episode.trajectory()
    return tracked_overlay(
        episode.experiment,
        reference_path(episode.experiment, episode.band),
        time_s=(episode.frame or 0) / FRAME_RATE_HZ,
        samples=trajectory.samples,
        markers_m=trajectory.markers_m[-1],
        poses=episode.poses(),
    )
