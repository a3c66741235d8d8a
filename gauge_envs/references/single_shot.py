"""Single-trial recordings: each has its own initial state, so they have no mean.

A variant outside the benchmark may have `scoring/single_shot/<variant>.npz` with the recordings and `<variant>.toml`
with their source and nuisances (`scoring/README.md`). Reading corrects the recordings by the nuisances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError
from gauge_envs.files import npz_arrays
from gauge_envs.references.band import Band, ExactLaw, RecordedEvent
from gauge_envs.references.kind import Kind
from gauge_envs.references.tables import scoring_folder
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import frame_times_s
from gauge_envs.text import toml_document

QUATERNION_UNIT = 1.0 / 32767.0
"""Value of one count of a stored quaternion."""


@dataclass(frozen=True, eq=False)
class SingleShot:
    """One recorded trial of a rigid body, in SI units in the world frame, corrected by the nuisances.

    Attributes:
        body: Name of the body.
        times_s: Times of the frames, from 0, shape [T].
        positions_m: Positions of the body origin, shape [T, 3].
        quaternions: Orientations w x y z, body to world, shape [T, 4].
        start: State at the first frame, shape [13], see `gauge_envs.scene.states`.
    """

    body: str
    times_s: FloatArray
    positions_m: FloatArray
    quaternions: FloatArray
    start: FloatArray

    def positions_at(self, times_s: FloatArray) -> FloatArray:
        """Return positions at other times [m], shape [Q, 3]: a cubic spline; after the last frame, the last position.

        Args:
            times_s: Times [s], shape [Q].
        """
        # The import takes 0.1 s, and lists of experiments do not need it.
        from scipy.interpolate import CubicSpline

        within_s = np.clip(times_s, 0.0, self.times_s[-1])
        positions_m: FloatArray = CubicSpline(self.times_s, self.positions_m)(within_s)
        return positions_m


@dataclass(frozen=True, eq=False)
class SingleShots:
    """All recorded trials of a variant.

    Trials keep the numbers of the data set, including copies. The trials of a half are independent: they contain no
    copies.

    Attributes:
        variant: Name of the variant.
        metadata: Content of the TOML file; `nuisances` are errors of the recordings, not of an engine.
        arrays: Arrays of the NPZ file.
    """

    variant: str
    metadata: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.arrays["source_number"])

    @property
    def copies(self) -> dict[int, int]:
        """Numbers of trials that repeat an earlier trial, with the number of the earlier one."""
        return {copy["trial"]: copy["of"] for copy in self.metadata["copies"]}

    def trials(self, half: Literal["fit", "judge"] | None = None) -> tuple[int, ...]:
        """Return independent trials, without those that repeat an earlier one.

        Args:
            half: `fit` for even numbers, to fit constants; `judge` for odd numbers; None for all.
        """
        first, step = {"fit": (0, 2), "judge": (1, 2), None: (0, 1)}[half]
        chosen = range(first, len(self), step)
        return tuple(trial for trial in chosen if trial not in self.copies)

    def shot(self, trial: int) -> SingleShot:
        """Return one trial, from 0.

        Raises:
            ParameterError: There is no such trial.
        """
        from scipy.spatial.transform import Rotation

        if not 0 <= trial < len(self):
            raise ParameterError(
                f"GAUGE/{self.variant}: trial {trial} does not exist: choose 0 to {len(self) - 1}"
            )
        data, nuisances = self.arrays, self.metadata["nuisances"]
        rows = slice(*data["first"][trial : trial + 2].tolist())
        unit_m = self.metadata["position_unit_m"] * nuisances["length_scale"]
        positions_m = unit_m * data["position"][rows].astype(np.float64)
        positions_m[:, 2] += nuisances["height_offset_m"]
        quaternions = QUATERNION_UNIT * data["quaternion"][rows].astype(np.float64)
        quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
        rotation = Rotation.from_quat(quaternions[0], scalar_first=True)
        # Recordings give the angular velocity in the body frame, scenes in the world frame.
        rate_of_body = data["start_angular_velocity_body"][trial].astype(np.float64)
        velocities = data["start_velocity"][trial], rotation.apply(rate_of_body)
        return SingleShot(
            body=self.metadata["body"],
            times_s=np.arange(len(positions_m)) / self.metadata["rate_hz"],
            positions_m=positions_m,
            quaternions=quaternions,
            start=np.concatenate([positions_m[0], quaternions[0], *velocities]),
        )

    def band(self, trial: int, frame_count: int) -> Band:
        """Return the band of one trial: positions at the frames, and the uncertainty of their measurement.

        Args:
            trial: Number of the trial.
            frame_count: Number of 30 Hz frames of an episode.
        """
        shot, nuisances = self.shot(trial), self.metadata["nuisances"]
        times_s = frame_times_s(frame_count)
        mean = 1e3 * shot.positions_at(times_s)
        if "position_std" in self.arrays:
            rows = self.arrays["first"][trial] + np.arange(frame_count)
            sigma = 1e3 * self.arrays["position_std"][rows].astype(np.float64)
        else:
            noise_m = nuisances["position_noise_m"], nuisances["rest_height_std_m"]
            sigma = np.full_like(mean, 1e3 * float(np.hypot(*noise_m)))
        repeats = ""
        if trial in self.copies:
            repeats = f" (the same recording as trial {self.copies[trial]})"
        return Band(
            kind=Kind.TRIALS,
            unit="mm",
            coordinates=tuple(f"{shot.body}.{axis}" for axis in "xyz"),
            projection=np.eye(3),
            mean=mean,
            sigma=sigma,
            measured=times_s <= shot.times_s[-1],
            trial_count=1,
            source=f"trial {trial}{repeats} of {self.metadata['source']}",
            uncertainty=sigma,
            normalized=False,
            exact_law=ExactLaw(law)
            if (law := self.metadata.get("exact_law"))
            else None,
            events=tuple(
                RecordedEvent(
                    name=event["name"],
                    unit=event["unit"],
                    value=float(self.arrays[event["name"]][trial]),
                    standard_uncertainty=float(
                        self.arrays[f"{event['name']}_std"][trial]
                    ),
                    source=event["source"],
                )
                for event in self.metadata.get("events", ())
            ),
        )


@cache
def single_shots(variant: str) -> SingleShots | None:
    """Return the recorded single-shot trials of a variant, or None."""
    file = scoring_folder("single_shot") / f"{variant}.npz"
    if not file.is_file():
        return None
    metadata = toml_document(file.with_suffix(".toml").read_bytes())
    return SingleShots(variant, metadata, npz_arrays(file.read_bytes()))
