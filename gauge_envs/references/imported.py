"""Store and read imported bands and drivers in the user's data folder.

Each variant has a file `<variant>.json`, which describes the numbers, and an NPZ file with the numbers, named by its
hash. The NPZ file is written first, and the JSON file then replaces the old one. An interrupted writer therefore leaves
the old import or the new one, never a mixture. Writers hold a lock on the folder: of two imports, the last one counts.

The environment variable `GAUGE_DATA_DIR` names the folder. The default is the platform's folder for user data, on Linux
`$XDG_DATA_HOME/gauge-envs` or `~/.local/share/gauge-envs`.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from gauge_envs.errors import DatasetError, ReferenceFileError, first_fault
from gauge_envs.files import (
    json_document,
    locked,
    npz_arrays,
    os_errors,
    write_whole,
)
from gauge_envs.references.bands import Band
from gauge_envs.references.deformation import DeformationReference
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.tables import FileModel, read_content
from gauge_envs.references.user_data import DataSource, trials_folder
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.timing import FRAME_RATE_HZ

START_FRAMES = 3
"""Number of first frames whose positions and orientations give the start velocities of a trial."""

READ_ATTEMPTS = 5
"""Number of times that a variant is read while imports replace it."""


class SpreadRecord(FileModel):
    """Mean and sample standard deviation (n - 1) of one metric over trials, in the metric's unit."""

    unit: str
    mean: float
    std: float | None
    trial_count: int

    @classmethod
    def of(cls, values: FloatArray, unit: str) -> SpreadRecord | None:
        """Return the spread of the finite ones of one value per trial; None without any."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return None
        std = float(finite.std(ddof=1)) if finite.size > 1 else None
        return cls(
            unit=unit, mean=float(finite.mean()), std=std, trial_count=int(finite.size)
        )


class DriverRecord(FileModel):
    """Quality of a recorded driver: how far the trials are from the mean that drives the body.

    Attributes:
        body: Name of the driven body.
        trial_count: Number of trials that show the body.
        residual_mm: Root mean square over trials and frames of the distance that the driver's motions cannot follow.
        residual_deg: Root mean square of the angle that they cannot follow; None if no trial has orientations.
        start_offset_mm: Mean over trials of the distance from the calibrated start, at which the driver starts.
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
    """Origin of the imported trials of one variant, and their scores.

    Attributes:
        variant: Name of the variant.
        left_out: Number of trial files that were left out.
        revision: Revision of the dataset; None for a folder that does not state it.
        files: Paths of the trials below the dataset's folder.
        files_sha256: Hash over the hashes of these files, in that order.
        task_sha256: Hash of the task file that they were imported for.
        metrics: Score of the trials among themselves, by metric.
        drivers: Recorded drivers.
        statistics: Names of the stored statistics of deformation; empty without markers on a solid.
    """

    variant: str
    left_out: int
    revision: str | None
    files: tuple[str, ...]
    files_sha256: str
    task_sha256: str
    metrics: dict[str, SpreadRecord]
    drivers: tuple[DriverRecord, ...]
    statistics: tuple[str, ...] = ()


class VariantRecord(ImportFacts):
    """The file `<variant>.json` of an imported variant.

    Attributes:
        format: Version of the stored form.
        arrays: Name of the NPZ file.
        arrays_sha256: Hash of the NPZ file.
        unit: Unit of the band.
        coordinates: Names of the band's coordinates.
        frame_count: Number of frames of the band.
        trial_count: Number of trials that the band rests on.
        created: Time of the import, ISO 8601, UTC.
        gauge_envs: Version of gauge-envs that imported it.
    """

    format: Literal[1] = 1
    arrays: Annotated[str, Field(pattern=r"^[\w.-]+\.npz$")]
    arrays_sha256: str
    unit: str
    coordinates: tuple[str, ...]
    frame_count: int
    trial_count: int
    created: str
    gauge_envs: str

    @property
    def origin(self) -> str:
        """Origin of the trials: `imported dataset revision 9e0acb7, 20 trials, sha256 0123456789ab`."""
        revision = (
            "of unknown revision"
            if self.revision is None
            else f"revision {self.revision[:12]}"
        )
        return f"imported dataset {revision}, {self.trial_count} trials, sha256 {self.files_sha256[:12]}"


@dataclass(frozen=True, eq=False)
class ImportedVariant:
    """One imported variant.

    Attributes:
        record: Description of the import.
        band: Band of the trials, of grade `trials`.
        driver_values: Mean recorded coordinates of each driven body relative to its start [m or rad], shape
            [frame_count, motion_count]; NaN where no trial shows the body.
        deformation: Statistics of deformation over the trials; None without any.
        start_quaternions: Orientations x y z w of the recorded bodies in the first frames of each trial, body to world,
            shape [trial_count, START_FRAMES, body_count, 4]; NaN where a trial has none. None for an import without.
    """

    record: VariantRecord
    band: Band
    driver_values: Mapping[str, FloatArray]
    deformation: DeformationReference | None = None
    start_quaternions: FloatArray | None = None


# --- writing ---------------------------------------------------------------------------------------------------------


def write_imported(
    band: Band,
    drivers: Mapping[str, FloatArray],
    facts: ImportFacts,
    deformation: DeformationReference | None = None,
    start_quaternions: FloatArray | None = None,
) -> VariantRecord:
    """Store an imported variant in place of an earlier import of it.

    Args:
        band: Band of the trials, in the coordinates of g(t).
        drivers: Recorded coordinates of the driven bodies, as `ImportedVariant.driver_values`.
        facts: Origin and scores of the trials; `statistics` names those of `deformation`.
        deformation: Statistics of deformation over the trials.
        start_quaternions: As in `ImportedVariant`.
    """
    stream = io.BytesIO()
    arrays: dict[str, Any] = {
        "mean": band.mean,
        "sigma": band.sigma,
        "measured": band.measured,
        "trials": band.trials,
        "start_quaternions": start_quaternions,
        **{f"driver.{body}": values for body, values in drivers.items()},
        "statistics.mean": deformation and deformation.mean,
        "statistics.sigma": deformation and deformation.sigma,
    }
    np.savez_compressed(
        stream,
        **{name: values for name, values in arrays.items() if values is not None},
    )
    content = stream.getvalue()
    digest = hashlib.sha256(content).hexdigest()
    record = VariantRecord(
        **dict(facts),
        arrays=f"{facts.variant}.{digest[:16]}.npz",
        arrays_sha256=digest,
        unit=band.unit,
        coordinates=band.coordinates,
        frame_count=len(band.mean),
        trial_count=band.trial_count or 0,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        gauge_envs=version("gauge-envs"),
    )
    folder = trials_folder()
    text = record.model_dump_json(indent=1) + "\n"
    with os_errors(
        lambda cause: DatasetError(
            f"{folder}: {facts.variant} cannot be written: {cause}"
        )
    ):
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder):
            write_whole(folder / record.arrays, content)
            write_whole(folder / f"{facts.variant}.json", text.encode())
            for stale in folder.glob(f"{facts.variant}.*.npz"):
                if stale.name != record.arrays:
                    stale.unlink(missing_ok=True)
    return record


def remove_leftovers() -> None:
    """Remove the files of imports that were killed: half-written files, and arrays that no variant names."""
    folder = trials_folder()
    if not folder.is_dir():
        return
    with (
        os_errors(lambda cause: DatasetError(f"{folder}: cannot be written: {cause}")),
        locked(folder),
    ):
        used = {_arrays_name(file) for file in folder.glob("*.json")}
        for file in [*folder.glob(".*.tmp"), *folder.glob("*.npz")]:
            if file.name not in used:
                file.unlink(missing_ok=True)


def _arrays_name(file: Path) -> str | None:
    """Return the name of the NPZ file of a variant; None for a damaged file, which has no use for its arrays."""
    try:
        return str(json_document(file.read_bytes())["arrays"])
    except (OSError, ValueError, TypeError, KeyError):
        return None


# --- reading ---------------------------------------------------------------------------------------------------------


def load_imported(variant: str) -> ImportedVariant | None:
    """Return the import of a variant, or None."""
    file = trials_folder() / f"{variant}.json"
    for _ in range(READ_ATTEMPTS):
        stamp = _stamp(file)
        if stamp is None:
            return None
        try:
            return _load(file, *stamp)
        except ReferenceFileError:
            # A file that was replaced while it was read is read again.
            if _stamp(file) == stamp:
                raise
    raise ReferenceFileError(
        file, None, "imports replace it all the time; wait until they end"
    )


def _stamp(file: Path) -> tuple[int, int] | None:
    """Return time and inode of a file; None without it."""
    try:
        status = file.stat()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ReferenceFileError(
            file, None, f"cannot be read: {error.strerror or error}"
        ) from error
    return status.st_mtime_ns, status.st_ino


@lru_cache(maxsize=256)
def _load(file: Path, mtime_ns: int, inode: int) -> ImportedVariant:
    """Read a variant; time and inode of the file distinguish imports in the cache."""
    record = _record(file)
    arrays_file = file.with_name(record.arrays)
    try:
        content = arrays_file.read_bytes()
        if hashlib.sha256(content).hexdigest() != record.arrays_sha256:
            raise ValueError("its content differs from what was imported")
        return _imported(record, content)
    except (OSError, ValueError, KeyError) as error:
        reason = (
            error.strerror or str(error)
            if isinstance(error, OSError)
            else f"is damaged: {error}"
        )
        raise ReferenceFileError(
            arrays_file, None, f"{reason}; gauge data import renews it"
        ) from None


def _record(file: Path) -> VariantRecord:
    content = read_content(file)
    try:
        record = VariantRecord.model_validate_json(content)
    except ValidationError as error:
        fault = ": ".join(first_fault(error))
        raise ReferenceFileError(
            file,
            None,
            f"is no import of this version: {fault}; gauge data import renews it",
        ) from None
    if Path(
        record.arrays
    ).name != record.arrays or record.variant != file.name.removesuffix(".json"):
        raise ReferenceFileError(
            file, None, f"belongs to {record.variant!r}; gauge data import renews it"
        )
    return record


def _imported(record: VariantRecord, content: bytes) -> ImportedVariant:
    """Return a variant from its description and the content of its NPZ file."""
    bodies = [entry.body for entry in record.drivers]
    wanted = [
        "mean",
        "sigma",
        "measured",
        "trials",
        "statistics.mean",
        "statistics.sigma",
        "start_quaternions",
    ]
    arrays = npz_arrays(content, [*wanted, *(f"driver.{body}" for body in bodies)])
    coordinate_count = len(record.coordinates)
    if arrays["mean"].shape != (record.frame_count, coordinate_count):
        raise ValueError(f"its mean has shape {arrays['mean'].shape}")
    # Imports of older versions hold no single trials and no orientations.
    starts = arrays.get("start_quaternions")
    shape = (record.trial_count, START_FRAMES, coordinate_count // 3, 4)
    if starts is not None and starts.shape != shape:
        raise ValueError(
            f"its start orientations have shape {starts.shape}, expected {shape}"
        )
    band = Band(
        grade=BandGrade.TRIALS,
        unit=record.unit,
        coordinates=record.coordinates,
        projection=np.eye(coordinate_count),
        mean=arrays["mean"],
        sigma=arrays["sigma"],
        measured=arrays["measured"],
        trial_count=record.trial_count,
        source=record.origin,
        trials=arrays.get("trials"),
    )
    deformation = None
    if record.statistics:
        deformation = DeformationReference(
            statistics=record.statistics,
            markers=None,
            mean=arrays["statistics.mean"],
            sigma=arrays["statistics.sigma"],
            trial_count=record.trial_count,
            source=record.origin,
        )
    return ImportedVariant(
        record,
        band,
        {body: arrays[f"driver.{body}"] for body in bodies},
        deformation,
        starts,
    )


# --- drivers ---------------------------------------------------------------------------------------------------------


def recorded_drivers(variant: str, bundled: tuple[Driver, ...]) -> tuple[Driver, ...]:
    """Return the drivers of a variant, with recorded motion for every body that imported trials show.

    Args:
        variant: Name of the variant.
        bundled: Drivers of the task file; axes and action rates stay.
    """
    imported = load_imported(variant)
    if imported is None:
        return bundled
    return tuple(
        _recorded(driver, imported.driver_values[driver.body], variant)
        if driver.body in imported.driver_values
        else driver
        for driver in bundled
    )


def _recorded(driver: Driver, values: FloatArray, variant: str) -> Driver:
    if values.ndim != 2 or values.shape[1] != len(driver.motions):
        raise ReferenceFileError(
            trials_folder() / f"{variant}.json",
            None,
            f"the driver of {driver.body} has {len(driver.motions)} motions, imported were {values.shape[-1]}; "
            "gauge data import renews it",
        )
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
    """Return the sources of drivers and reference, for a result.

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
        "revision": imported.record.revision or "unknown",
        "sha256": imported.record.files_sha256,
    }
