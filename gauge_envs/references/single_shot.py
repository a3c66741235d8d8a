"""Single-shot trials: recordings that each have a start of their own, so that no mean over them exists.

A variant beyond the benchmark may have `scoring/single_shot/<variant>.npz` with the recordings and a sidecar
`<variant>.toml` with their source and nuisances. `scoring/README.md` describes both files. The recordings are corrected
by the nuisances when they are read.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt, PositiveInt

from gauge_envs.errors import ParameterError
from gauge_envs.files import npz_arrays
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.tables import (
    FileModel,
    faults_of,
    read_content,
    read_toml,
    scoring_folder,
)
from gauge_envs.scene.geometry import FloatArray, NonNegative, Positive
from gauge_envs.scene.timing import FRAME_RATE_HZ

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Half = Literal["fit", "judge"]

QUATERNION_UNIT = 1.0 / 32767.0
"""Value of one count of a stored quaternion."""


class ShotNuisances(FileModel):
    """Errors of a recording that no engine can answer for, fitted on the half of the trials that is not scored.

    Attributes:
        length_scale: Factor on recorded lengths and speeds, from the acceleration in free flight.
        length_scale_std_error: Standard error of it.
        height_offset_m: Height that is added after the scale, so that the resting body touches z = 0.
        velocity_lag_s: Time by which a recorded velocity is late: half an interval for backward differences.
        position_noise_m: Standard deviation of a position in free flight about a parabola.
        rotation_noise_deg: Standard deviation of a rotation angle, per axis, in free flight about a constant rate.
        rest_height_std_m: Standard deviation of the rest height over the trials.
        rest_tilt_deg: Root mean square of the angle between the upper face and the horizontal at rest.
        start_velocity_std_m_per_s: Standard error of each start velocity.
        start_angular_velocity_std_rad_per_s: Standard error of each start angular velocity.
    """

    length_scale: Positive
    length_scale_std_error: Positive
    height_offset_m: float
    velocity_lag_s: NonNegative
    position_noise_m: Positive
    rotation_noise_deg: Positive
    rest_height_std_m: Positive
    rest_tilt_deg: Positive
    start_velocity_std_m_per_s: Positive
    start_angular_velocity_std_rad_per_s: Positive


class CopiedTrial(FileModel):
    """A trial that is the same recording as an earlier one, laid elsewhere on the table: it is no trial of its own.

    Attributes:
        trial: Number of the trial.
        of: Number of the earlier one, which is no copy itself.
    """

    trial: NonNegativeInt
    of: NonNegativeInt


class ShotSidecar(FileModel):
    """What is known about the recordings of a variant.

    Attributes:
        body: Name of the recorded body.
        trial_count: Number of trials.
        rate_hz: Frames a second of the recordings.
        position_unit_m: Value of one count of a stored position.
        fit: Rule of the half that constants and nuisances may be fitted on; the other half judges.
        source: Where the recordings are from, one sentence.
        source_sha256: Hash of the file that the script has read.
        licence: File in the same folder with the licence of the recordings.
        nuisances: Errors of the recordings.
        copies: Trials that repeat an earlier one.
    """

    body: str
    trial_count: PositiveInt
    rate_hz: Positive
    position_unit_m: Positive
    fit: Literal["even"]
    source: str
    source_sha256: str = Field(pattern="^[0-9a-f]{64}$")
    licence: str
    nuisances: ShotNuisances
    copies: tuple[CopiedTrial, ...] = ()


ARRAYS = (
    "source_number",
    "first",
    "position",
    "quaternion",
    "start_velocity",
    "start_angular_velocity_body",
)
"""Arrays of a file of recordings; `scoring/README.md` gives their shapes."""


@dataclass(frozen=True, eq=False)
class SingleShot:
    """One recorded trial of a rigid body, in SI units in the world frame, corrected by the nuisances.

    Attributes:
        body: Name of the body.
        trial: Number of the trial, from 0.
        source_number: Number of the trial in the source.
        times_s: Times of the frames, from 0, shape [T].
        positions_m: Positions of the body origin, shape [T, 3].
        quaternions: Orientations w x y z, body to world, shape [T, 4].
        velocity_m_per_s: Velocity at the first frame, shape [3].
        angular_velocity_rad_per_s: Angular velocity at the first frame in the world frame, shape [3].
    """

    body: str
    trial: int
    source_number: int
    times_s: FloatArray
    positions_m: FloatArray
    quaternions: FloatArray
    velocity_m_per_s: FloatArray
    angular_velocity_rad_per_s: FloatArray

    @property
    def rotations(self) -> Rotation:
        """Orientations, body to world, T of them."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternions, scalar_first=True)

    @property
    def duration_s(self) -> float:
        """Time of the last frame [s]."""
        return float(self.times_s[-1])

    def poses_at(self, times_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """Return the recorded poses at other times; after the last frame the body keeps its last pose.

        Between frames, positions are a cubic spline without kinks at the frames and rotations have a constant rate.

        Args:
            times_s: Times [s], shape [Q].

        Returns:
            Positions [m], shape [Q, 3], and orientations.
        """
        # Lists of experiments need no spline, and the import takes a tenth of a second.
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Slerp

        within_s = np.clip(times_s, 0.0, self.duration_s)
        return CubicSpline(self.times_s, self.positions_m)(within_s), Slerp(
            self.times_s, self.rotations
        )(within_s)


@dataclass(frozen=True, eq=False)
class SingleShots:
    """All recorded trials of a variant.

    Trials keep the numbers of the data set, copies too. The trials of a half are independent: copies are in none.

    Attributes:
        variant: Name of the variant.
        sidecar: What is known about them.
        arrays: Content of the file of recordings.
    """

    variant: str
    sidecar: ShotSidecar
    arrays: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return self.sidecar.trial_count

    @cached_property
    def copies(self) -> dict[int, int]:
        """Trials that repeat an earlier one, with the number of that one."""
        return {copy.trial: copy.of for copy in self.sidecar.copies}

    def trials(self, half: Half | None = None, *, every: int = 1) -> tuple[int, ...]:
        """Return independent trials: without those that repeat an earlier one.

        Args:
            half: `fit` for even numbers, which constants may be fitted on; `judge` for odd ones; None for all.
            every: Count of trials, copies included, from one to the next.
        """
        first, step = {"fit": (0, 2), "judge": (1, 2), None: (0, 1)}[half]
        return tuple(
            trial
            for trial in range(first, len(self), step * every)
            if trial not in self.copies
        )

    def shot(self, trial: int) -> SingleShot:
        """Return one trial, from 0."""
        from scipy.spatial.transform import Rotation

        if not 0 <= trial < len(self):
            raise ParameterError(
                f"GAUGE/{self.variant}: trial {trial} does not exist: choose 0 to {len(self) - 1}"
            )
        data, nuisances = self.arrays, self.sidecar.nuisances
        rows = slice(*(int(row) for row in data["first"][trial : trial + 2]))
        positions_m = (
            self.sidecar.position_unit_m
            * nuisances.length_scale
            * data["position"][rows].astype(np.float64)
        )
        positions_m[:, 2] += nuisances.height_offset_m
        quaternions = QUATERNION_UNIT * data["quaternion"][rows].astype(np.float64)
        quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
        start = Rotation.from_quat(quaternions[0], scalar_first=True)
        return SingleShot(
            body=self.sidecar.body,
            trial=trial,
            source_number=int(data["source_number"][trial]),
            times_s=np.arange(len(positions_m)) / self.sidecar.rate_hz,
            positions_m=positions_m,
            quaternions=quaternions,
            velocity_m_per_s=data["start_velocity"][trial].astype(np.float64),
            # Recordings state the rate about the axes of the body, scenes about those of the world.
            angular_velocity_rad_per_s=start.apply(
                data["start_angular_velocity_body"][trial].astype(np.float64)
            ),
        )

    def band(self, trial: int, frame_count: int) -> Band:
        """Return the band of one trial: positions at the frames, and the uncertainty of measuring them.

        Args:
            trial: Number of the trial.
            frame_count: Number of 30 Hz frames of an episode.
        """
        shot, nuisances = self.shot(trial), self.sidecar.nuisances
        times_s = np.arange(frame_count) / FRAME_RATE_HZ
        mean = 1e3 * shot.poses_at(times_s)[0]
        sigma = 1e3 * float(
            np.hypot(nuisances.position_noise_m, nuisances.rest_height_std_m)
        )
        repeats = (
            f" (the same recording as trial {self.copies[trial]})"
            if trial in self.copies
            else ""
        )
        return Band(
            kind=Kind.TRIALS,
            unit="mm",
            coordinates=tuple(f"{shot.body}.{axis}" for axis in "xyz"),
            projection=np.eye(3),
            mean=mean,
            sigma=np.full_like(mean, sigma),
            measured=times_s <= shot.duration_s,
            trial_count=1,
            source=f"trial {trial}{repeats} of {self.sidecar.source}",
            uncertainty=np.full_like(mean, sigma),
            normalized=False,
        )


def single_shots(variant: str) -> SingleShots | None:
    """Return the recorded single-shot trials of a variant, or None."""
    return _read(scoring_folder("single_shot") / f"{variant}.npz", variant)


@cache
def _read(file: Path, variant: str) -> SingleShots | None:
    if not file.is_file():
        return None
    sidecar = read_toml(file.with_suffix(".toml"), ShotSidecar)
    with faults_of(file):
        arrays = npz_arrays(read_content(file), ARRAYS)
    return SingleShots(variant, sidecar, arrays)
