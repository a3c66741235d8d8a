"""Episodes as recordings for the Rerun viewer: bodies, cloth, markers, the recorded mean, and g(t).

The result file has g(t) alone, so the episode is run again (`runs.replay`), which fails if g(t) differs from the file.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ResultFileError, needs_extra
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.reference_path import ghost_trajectory
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import Band
from gauge_envs.rendering.skin import Skin
from gauge_envs.runs.replay import Replay, replay, replayed_experiment
from gauge_envs.runs.result import Result
from gauge_envs.scene import (
    Cloth,
    Deformable,
    Motion,
    Plane,
    Pose,
    Rod,
    Rope,
    Shape,
    SoftBody,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

TIMELINE = "time"
COLORS = {
    Motion.DYNAMIC: (230, 133, 43, 255),
    Motion.KINEMATIC: (77, 128, 191, 255),
    Motion.FIXED: (184, 168, 143, 255),
}
PLANE_COLOR = (205, 208, 212, 255)
GHOST_COLOR = (60, 150, 90, 110)
MARKER_COLOR = (25, 25, 25, 255)
MARKER_RADIUS_M = 0.003
PATH_RADIUS_M = 0.001
MOST_PLOTTED = 24
"""Largest number of coordinates in the plots; a wall of bricks has 354."""


def write_rerun(result: Result, file: Path, *, use_withheld: bool = False) -> Path:
    """Write an episode as a recording for the Rerun viewer, and return its path.

    Args:
        result: A result of an installed engine.
        file: The recording, `*.rrd`; its folder is created.
        use_withheld: Show also a reference that is withheld by default.
    """
    with needs_extra("the recording for Rerun", "rerun"):
        import rerun
        import trimesh  # noqa: F401
    experiment = replayed_experiment(result)
    again = replay(result)
    band = reference_band(experiment, use_withheld=use_withheld)
    stream = rerun.RecordingStream(f"gauge-envs {experiment.name}")
    recording = _Recording(rerun, stream, experiment, again)
    recording.scene()
    assert result.trajectory is not None
    times_s, samples = result.trajectory.arrays()
    if band is not None:
        recording.ghost(band, samples[::SAMPLES_PER_FRAME])
    recording.plots(band, times_s, samples)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        stream.save(file, default_blueprint=_blueprint())
        stream.flush()
        stream.disconnect()
    except (OSError, RuntimeError) as error:
        raise ResultFileError(f"{file}: cannot be written: {error}") from error
    return file


def _blueprint() -> Any:
    """Return the layout of the viewer: the scene on the left, the coordinates on the right."""
    import rerun.blueprint as layout

    return layout.Blueprint(
        layout.Horizontal(
            layout.Spatial3DView(origin="/world", name="scene"),
            layout.TimeSeriesView(origin="/g", name="g(t)"),
            column_shares=[3, 2],
        ),
        collapse_panels=True,
    )


class _Recording:
    """What is logged of one episode.

    Args:
        rerun: The module.
        stream: The recording.
        experiment: The experiment with the start of the episode.
        again: The episode.
    """

    def __init__(
        self, rerun: Any, stream: Any, experiment: Experiment, again: Replay
    ) -> None:
        self._rerun = rerun
        self._stream = stream
        self._experiment = experiment
        self._scene = experiment.scene
        self._again = again
        self._view_times_s = np.arange(len(again.poses)) / again.rate_hz
        stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def scene(self) -> None:
        """Log the bodies, the surfaces and lines of deformable ones at each view, and their markers at each frame."""
        for body in self._scene.bodies:
            path = f"world/bodies/{body.name}"
            self._shape(
                path,
                body.shape,
                PLANE_COLOR if isinstance(body.shape, Plane) else COLORS[body.motion],
            )
            if body.name in self._again.bodies:
                poses = self._again.poses[:, self._again.bodies.index(body.name)]
                self._poses(path, self._view_times_s, poses[:, :3], poses[:, 3:])
            else:
                self._stream.log(path, self._transform(body.pose), static=True)
        for soft in self._scene.deformables:
            nodes = np.asarray(self._again.nodes_m[soft.name], dtype=np.float64)
            faces = (
                Skin(soft, nodes[0]).faces
                if isinstance(soft, Cloth | SoftBody)
                else None
            )
            for time_s, points in zip(self._view_times_s, nodes, strict=True):
                self._stream.set_time(TIMELINE, duration=float(time_s))
                self._stream.log(
                    f"world/bodies/{soft.name}", self._surface(soft, points, faces)
                )
        for frame, points in enumerate(self._again.markers_m):
            if len(points):
                self._points(
                    "world/markers", frame / FRAME_RATE_HZ, points, MARKER_COLOR
                )

    def ghost(self, band: Band, frames: FloatArray) -> None:
        """Log the recorded mean where it is a place in space: as bodies, or as markers.

        A mean has positions alone; a ghost body turns as the simulated one.
        """
        observable = self._experiment.score.observable
        if observable.unit != "mm":
            return
        points = 1e-3 * ghost_trajectory(band, frames).reshape(len(frames), -1, 3)
        known = np.isfinite(points).all(axis=(1, 2))
        times_s = np.arange(len(frames))[known] / FRAME_RATE_HZ
        if observable is Observable.MARKER_POSITION:
            for time_s, places in zip(times_s, points[known], strict=True):
                self._points("world/mean/markers", float(time_s), places, GHOST_COLOR)
            return
        simulated = 1e-3 * frames.reshape(len(frames), -1, 3)
        views = round(self._again.rate_hz / FRAME_RATE_HZ)
        for number, name in enumerate(self._experiment.recorded):
            path = f"world/mean/{name}"
            turned = self._again.poses[::views, self._again.bodies.index(name), 3:][
                : len(frames)
            ]
            self._shape(path, self._scene.body(name).shape, GHOST_COLOR)
            self._poses(path, times_s, points[known, number], turned[known])
            self._path(f"world/paths/{name}/mean", points[known, number], GHOST_COLOR)
            self._path(
                f"world/paths/{name}/simulated",
                simulated[:, number],
                COLORS[Motion.DYNAMIC],
            )

    def plots(
        self, band: Band | None, times_s: FloatArray, samples: FloatArray
    ) -> None:
        """Log the scored coordinates with the mean and two standard deviations, or g(t) without a band.

        Args:
            band: The band, or None.
            times_s: Times of the samples [s], shape [sample_count].
            samples: g(t), shape [sample_count, coordinate_count].
        """
        names = self._experiment.coordinates if band is None else band.coordinates
        values = samples if band is None else band.project(samples)
        for number, name in enumerate(names[:MOST_PLOTTED]):
            path = f"g/{name}"
            self._series(
                f"{path}/simulated",
                times_s,
                values[:, number],
                COLORS[Motion.DYNAMIC],
                width=2.0,
            )
            if band is None:
                continue
            frames_s = np.arange(len(band.mean)) / FRAME_RATE_HZ
            mean, spread = band.mean[:, number], 2.0 * band.sigma[:, number]
            self._series(f"{path}/mean", frames_s, mean, GHOST_COLOR, width=2.0)
            self._series(f"{path}/low", frames_s, mean - spread, GHOST_COLOR, width=0.7)
            self._series(
                f"{path}/high", frames_s, mean + spread, GHOST_COLOR, width=0.7
            )

    # --- parts ---

    def _series(
        self,
        path: str,
        times_s: FloatArray,
        values: FloatArray,
        color: tuple[int, ...],
        *,
        width: float,
    ) -> None:
        known = np.isfinite(values)
        self._stream.log(
            path,
            self._rerun.SeriesLines(
                colors=[color], widths=[width], names=[path.removeprefix("g/")]
            ),
            static=True,
        )
        self._rerun.send_columns(
            path,
            indexes=[self._rerun.TimeColumn(TIMELINE, duration=times_s[known])],
            columns=self._rerun.Scalars.columns(scalars=values[known]),
            recording=self._stream,
        )

    def _poses(
        self, path: str, times_s: FloatArray, positions_m: Any, quaternions: Any
    ) -> None:
        self._rerun.send_columns(
            path,
            indexes=[self._rerun.TimeColumn(TIMELINE, duration=times_s)],
            columns=self._rerun.Transform3D.columns(
                translation=np.asarray(positions_m),
                quaternion=np.roll(np.asarray(quaternions), -1, axis=1),
            ),
            recording=self._stream,
        )

    def _points(
        self, path: str, time_s: float, points_m: Any, color: tuple[int, ...]
    ) -> None:
        self._stream.set_time(TIMELINE, duration=time_s)
        self._stream.log(
            path,
            self._rerun.Points3D(
                np.asarray(points_m), radii=MARKER_RADIUS_M, colors=[color]
            ),
        )

    def _path(self, path: str, points_m: FloatArray, color: tuple[int, ...]) -> None:
        lines = self._rerun.LineStrips3D(
            [points_m], radii=PATH_RADIUS_M, colors=[color]
        )
        self._stream.log(path, lines, static=True)

    def _transform(self, pose: Pose) -> Any:
        w, x, y, z = pose.quaternion
        return self._rerun.Transform3D(
            translation=pose.position_m,
            quaternion=self._rerun.Quaternion(xyzw=(x, y, z, w)),
        )

    def _surface(
        self, body: Deformable, points_m: FloatArray, faces: NDArray[np.intp] | None
    ) -> Any:
        color = COLORS[Motion.DYNAMIC]
        if faces is None:
            assert isinstance(body, Rope | Rod)
            return self._rerun.LineStrips3D(
                [points_m], radii=body.radius_m, colors=[color]
            )
        import trimesh

        normals = trimesh.Trimesh(points_m, faces, process=False).vertex_normals
        return self._rerun.Mesh3D(
            vertex_positions=points_m,
            triangle_indices=faces,
            vertex_normals=normals,
            albedo_factor=color,
        )

    def _shape(self, path: str, shape: Shape, color: tuple[int, ...]) -> None:
        """Log a shape in the frame of its body."""
        mesh = shape.mesh()
        drawn = self._rerun.Mesh3D(
            vertex_positions=mesh.vertices,
            triangle_indices=mesh.faces,
            albedo_factor=color,
        )
        self._stream.log(f"{path}/shape", drawn, static=True)
