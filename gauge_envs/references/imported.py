"""Imported trials: the reference of each variant, its driven motion and its initial states, in the user's folder.

An import is one file `<variant>.npz`, so an interrupted import leaves the earlier one. It has the arrays of a band, the
recorded motion of driven bodies, initial orientations, and a description with the origin of the trials. The environment
variable `GAUGE_DATA_DIR` sets the folder. The default is the platform's folder for user data, on Linux
`$XDG_DATA_HOME/gauge-envs` or `~/.local/share/gauge-envs`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gauge_envs.errors import DatasetError, ReferenceFileError
from gauge_envs.files import npz_arrays, os_errors, write_whole
from gauge_envs.reading import reading
from gauge_envs.references.band import (
    ABOUT,
    ARRAYS,
    FILE_FIELDS,
    Band,
    load_band,
    read_band_file,
    renewal,
)
from gauge_envs.references.tables import FileModel
from gauge_envs.references.user_data import DataSource, imported_file
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.timing import FRAME_RATE_HZ

START_FRAMES = 3
"""Number of first frames from which the initial velocities of a trial are computed."""


class SpreadRecord(FileModel):
    """Mean and sample standard deviation (n - 1) of one metric over trials, in the metric's unit."""

    unit: str
    mean: float
    std: float | None
    trial_count: int

    @classmethod
    def of(cls, values: FloatArray, unit: str) -> SpreadRecord | None:
        """Return the spread of the finite values, one per trial; None without any."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return None
        std = float(finite.std(ddof=1)) if finite.size > 1 else None
        return cls(
            unit=unit, mean=float(finite.mean()), std=std, trial_count=int(finite.size)
        )


class DriverRecord(FileModel):
    """Quality of a recorded driver: the distance of the trials from the mean that drives the body.

    Attributes:
        body: Name of the driven body.
        trial_count: Number of trials that show the body.
        residual_mm: Root mean square over trials and frames of the distance that the driver cannot reproduce.
        residual_deg: Root mean square of the angle that the driver cannot reproduce; None without orientations.
        start_offset_mm: Mean over trials of the distance from the published start, at which the driver starts.
        scatter_mm: Largest standard deviation of a translation over trials, 0 for one trial; None without translation.
        scatter_deg: Largest standard deviation of a rotation over trials, 0 for one trial; None without rotation.
    """

    body: str
    trial_count: int
    residual_mm: float
    residual_deg: float | None
    start_offset_mm: float
    scatter_mm: float | None
    scatter_deg: float | None


class ImportFacts(FileModel):
    """Origin and scores of the imported trials of one variant: the table `imported` of its TOML file.

    Attributes:
        variant: Name of the variant.
        left_out: Number of skipped trial files.
        revision: Revision of the dataset; None if the folder does not give it.
        files: Paths of the trials below the dataset's folder.
        files_sha256: Hash over the hashes of these files, in that order.
        task_sha256: Hash of the task file at the import.
        metrics: Score of the trials among themselves, by metric.
        drivers: Recorded drivers.
    """

    variant: str
    left_out: int
    revision: str | None = None
    files: tuple[str, ...]
    files_sha256: str
    task_sha256: str
    metrics: dict[str, SpreadRecord]
    drivers: tuple[DriverRecord, ...]

    def origin(self, trial_count: int) -> str:
        """Return the origin: `imported dataset revision 9e0acb7, 20 trials, sha256 0123456789ab`."""
        revision = "of unknown revision"
        if self.revision is not None:
            revision = f"revision {self.revision[:12]}"
        return f"imported dataset {revision}, {trial_count} trials, sha256 {self.files_sha256[:12]}"


@dataclass(frozen=True, eq=False)
class ImportedVariant:
    """One imported variant.

    Attributes:
        facts: Origin of the trials.
        band: Band of the trials.
        driver_values: Mean recorded coordinates of each driven body relative to its start [m or rad], shape
            [frame_count, motion_count]; NaN where no trial shows the body.
        start_quaternions: Orientations x y z w of the recorded bodies in the first frames of each trial, body to world,
            shape [trial_count, START_FRAMES, body_count, 4]; NaN where a trial has none. None without orientations.
    """

    facts: ImportFacts
    band: Band
    driver_values: Mapping[str, FloatArray]
    start_quaternions: FloatArray | None = None


def write_imported(
    band: Band,
    drivers: Mapping[str, FloatArray],
    facts: ImportFacts,
    start_quaternions: FloatArray | None = None,
) -> None:
    """Store an imported variant; it replaces an earlier import.

    Args:
        band: Band of the trials, in the coordinates of g(t).
        drivers: Recorded coordinates of the driven bodies, as `ImportedVariant.driver_values`.
        facts: Origin and scores of the trials.
        start_quaternions: As in `ImportedVariant`.

    Raises:
        DatasetError: The folder cannot be written.
    """
    arrays = {name: getattr(band, name) for name in ARRAYS}
    arrays |= {f"driver.{body}": values for body, values in drivers.items()}
    arrays["start_quaternions"] = start_quaternions
    about = {name: getattr(band, name) for name in ("kind", *FILE_FIELDS)}
    about["imported"] = facts.model_dump()
    arrays[ABOUT] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        **{name: values for name, values in arrays.items() if values is not None},
    )
    file = imported_file(facts.variant)
    with os_errors(lambda cause: DatasetError(f"{file}: cannot be written: {cause}")):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, stream.getvalue())


def load_imported(variant: str) -> ImportedVariant | None:
    """Return the import of a variant, or None.

    Raises:
        ReferenceFileError: The file is damaged; the message has the command that renews it.
    """
    file = imported_file(variant)
    band = load_band(variant, DataSource.IMPORTED)
    if band is None or not file.is_file():
        return None
    with reading(file, ReferenceFileError, hint=renewal(file)) as content:
        facts = ImportFacts.model_validate(read_band_file(file).imported)
        if facts.variant != variant:
            raise ValueError(f"it is the import of {facts.variant}")
        bodies = [driver.body for driver in facts.drivers]
        names = [f"driver.{body}" for body in bodies]
        arrays = npz_arrays(content, (*names, "start_quaternions"))
        return ImportedVariant(
            facts=facts,
            band=band,
            driver_values={body: arrays[f"driver.{body}"] for body in bodies},
            start_quaternions=arrays.get("start_quaternions"),
        )


def recorded_drivers(variant: str, bundled: tuple[Driver, ...]) -> tuple[Driver, ...]:
    """Return the drivers of a variant, with recorded motion for every body that the imported trials show.

    Args:
        variant: Name of the variant.
        bundled: Drivers of the task file; axes and action rates stay.

    Raises:
        ReferenceFileError: The import belongs to an older task file with other motions.
    """
    imported = load_imported(variant)
    if imported is None:
        return bundled
    drivers = []
    for driver in bundled:
        values = imported.driver_values.get(driver.body)
        if values is None:
            drivers.append(driver)
        elif values.shape[1:] == (len(driver.motions),):
            drivers.append(_recorded(driver, values))
        else:
            file = imported_file(variant)
            raise ReferenceFileError(
                file,
                None,
                f"the driver of {driver.body} has {len(driver.motions)} motions, the import has {values.shape[-1]}; "
                f"{renewal(file)}",
            )
    return tuple(drivers)


def _recorded(driver: Driver, values: FloatArray) -> Driver:
    """Return a driver that follows recorded coordinates, shape [frame_count, motion_count]."""
    motions = []
    for motion, column in zip(driver.motions, values.T, strict=True):
        frames = np.flatnonzero(np.isfinite(column))
        profile = SampledProfile(
            times_s=tuple((frames / FRAME_RATE_HZ).tolist()),
            values=tuple(column[frames].tolist()),
        )
        motions.append(replace(motion, profiles=(profile,)))
    return replace(driver, motions=tuple(motions), provenance="mocap")


def dataset_record(
    variant: str, *, drivers: DataSource, reference: DataSource
) -> dict[str, str]:
    """Return the sources of drivers and reference for a result.

    Args:
        variant: Name of the variant.
        drivers: Source of the driven motion.
        reference: Source of the band.

    Returns:
        `drivers` and `reference`; and `revision` and `sha256` of the import, if one of them is imported.
    """
    sources = {"drivers": drivers.value, "reference": reference.value}
    imported = (
        load_imported(variant) if DataSource.IMPORTED in (drivers, reference) else None
    )
    if imported is None:
        return sources
    return sources | {
        "revision": imported.facts.revision or "unknown",
        "sha256": imported.facts.files_sha256,
    }
