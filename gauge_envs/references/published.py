"""Published scores of real trials and of three engines, laws of the real outcome of variants, and times of events."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveInt

from gauge_envs.errors import ReferenceFileError, ShapeError, UnknownNameError
from gauge_envs.references.bands import Band, SigmaSource
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.metrics import MetricKey
from gauge_envs.references.tables import FileModel, read_rows, read_toml, scoring_folder
from gauge_envs.scene.geometry import Positive

PUBLISHED_ENGINES = {"isaacsim": "Isaac Sim", "genesis": "Genesis", "newton": "Newton"}
"""Titles of the engines whose scores were published, by column of the file."""


@dataclass(frozen=True)
class Baseline:
    """One row of the published results (paper, Table 5): scores of real trials and of three engines.

    Attributes:
        variant: Variant id, as in `SlopeSlider-2-wood`.
        metric: `rmse`, `dtw`, `lsd`, `mte`, `pd` or `el`.
        frames: Number of 30 Hz frames that were evaluated.
        unit: Unit of mean and std: `mm`, `rad`, `mm^2`, `s` or `1`. MTE is a ratio here, a percentage in the paper.
        mean: Mean over real trials.
        std: Standard deviation over real trials; None if none was published.
        engines: Published score of `isaacsim`, `genesis` and `newton` over `mean`; None if none was published. For el
            it is the raw score, as the mean is 0.
    """

    variant: str
    metric: str
    frames: int
    unit: str
    mean: float
    std: float | None
    engines: Mapping[str, float | None]


def published_baselines(variant: str) -> dict[str, Baseline]:
    """Return the published baselines of a variant by metric, which may be none."""
    return dict(_all_baselines(scoring_folder("published")).get(variant, {}))


def published_variants() -> tuple[str, ...]:
    """Return the variants with a published baseline, in the order of the paper's Table 5."""
    return tuple(_all_baselines(scoring_folder("published")))


class _BaselineRow(FileModel):
    """One row of `engine_results.csv`; its fields are the columns."""

    variant: str
    frames: PositiveInt
    metric: MetricKey
    unit: str
    baseline_mean: float
    baseline_std: float | None
    isaacsim: float | None
    genesis: float | None
    newton: float | None

    def baseline(self) -> Baseline:
        """Return the row with percentages as ratios."""
        percent = self.unit == "percent"
        mean, std = self.baseline_mean, self.baseline_std
        return Baseline(
            variant=self.variant,
            metric=self.metric,
            frames=self.frames,
            unit="1" if percent else self.unit,
            mean=mean / 100 if percent else mean,
            std=std / 100 if percent and std is not None else std,
            engines={engine: getattr(self, engine) for engine in PUBLISHED_ENGINES},
        )


@cache
def _all_baselines(folder: Path) -> dict[str, dict[str, Baseline]]:
    file = folder / "engine_results.csv"
    table: dict[str, dict[str, Baseline]] = {}
    for line, row in read_rows(file, list(_BaselineRow.model_fields), _BaselineRow):
        metrics = table.setdefault(row.variant, {})
        if row.metric in metrics:
            raise ReferenceFileError(
                file, line, f"{row.variant} has a second row for {row.metric}"
            )
        metrics[row.metric] = row.baseline()
    return table


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference that an experiment file states.

    Attributes:
        band: Mean and scatter of reality; None without a band.
        baselines: Scores of real trials by metric; normalized scores are divided by their mean.
    """

    band: Band | None
    baselines: Mapping[str, Baseline]


class Law(FileModel):
    """A closed form that gives the real outcome of some variants (`scoring/bands/laws.toml`).

    Attributes:
        variants: Shell-style patterns of the variants that it covers, separated by spaces.
        body: Name of the body whose motion the law gives.
        condition: Condition under which the law holds, with its numbers.
        evidence: Measurements or published results that support it.
    """

    variants: str
    body: str
    condition: str
    evidence: str


class CarriedLaw(Law):
    """The body keeps its place on a carrier, which moves as the scene's driver states.

    Attributes:
        kind: Name of the law in the file.
        carrier: Name of the body that carries it.
    """

    kind: Literal["carried"]
    carrier: str


class UncontactedLaw(Law):
    """A motion from rest that ends at an event of the nominal scene, after which nothing is known.

    Attributes:
        sigma_mm: 1-sigma uncertainty of a measured coordinate [mm], which is the sigma of the band.
    """

    sigma_mm: Positive


class FlightLaw(UncontactedLaw):
    """The body falls freely until it first touches another one.

    Attributes:
        kind: Name of the law in the file.
    """

    kind: Literal["free_flight"]


class SlideLaw(UncontactedLaw):
    """The body slides down a face of another one with Coulomb friction until it tips over the face's edge.

    Attributes:
        kind: Name of the law in the file.
        support: Name of the fixed body on which it slides.
    """

    kind: Literal["slide"]
    support: str


class PendulumLaw(UncontactedLaw):
    """A motion of rigid pendulums whose length and start are known to some uncertainty.

    Attributes:
        length_sigma_mm: 1-sigma uncertainty of the distance from the axis [mm].
        angle_sigma_deg: 1-sigma uncertainty of the angle at the start [deg].
    """

    length_sigma_mm: Positive
    angle_sigma_deg: Positive


class SwingLaw(PendulumLaw):
    """The body swings on a hinge without losses, until its phase is not known any more.

    Attributes:
        kind: Name of the law in the file.
        damping_per_s: Rate at which the real amplitude decays [1/s], which the law leaves out.
    """

    kind: Literal["swing"]
    damping_per_s: Positive


class ChainLaw(PendulumLaw):
    """The body is the last ball of a row that passes on a blow with the published share of the speed.

    Attributes:
        kind: Name of the law in the file.
        first: Name of the ball that is released.
    """

    kind: Literal["chain"]
    first: str


class PulledLaw(UncontactedLaw):
    """The body keeps its place on a cloth that a driven body pulls off a table.

    Attributes:
        kind: Name of the law in the file.
        carrier: Name of the body that pulls.
        cloth: Name of the cloth.
        table: Name of the body on which the cloth lies.
        speed_sigma_mm_per_s: 1-sigma uncertainty of the speed of the pull [mm/s].
    """

    kind: Literal["pulled"]
    carrier: str
    cloth: str
    table: str
    speed_sigma_mm_per_s: Positive


class UniaxialLaw(Law):
    """The body is an elastic bar that its ends stretch or compress; the law gives the areas of its marked faces.

    Attributes:
        kind: Name of the law in the file.
        carrier: Name of the body that moves one end.
        sigma_mm: 1-sigma uncertainty of a measured marker [mm], for a variant without a published scatter.
        left_out_share: 1-sigma share by which the real strain differs from that of a linear bar between its grips.
    """

    kind: Literal["uniaxial"]
    carrier: str
    sigma_mm: Positive
    left_out_share: Positive


AnyUncontactedLaw = FlightLaw | SlideLaw | SwingLaw | ChainLaw | PulledLaw
AnyLaw = CarriedLaw | UniaxialLaw | AnyUncontactedLaw


class _Laws(FileModel):
    """The file `laws.toml`."""

    law: Annotated[
        tuple[Annotated[AnyLaw, Field(discriminator="kind")], ...], Field(min_length=1)
    ]


def law_for(variant: str) -> AnyLaw | None:
    """Return the law that gives the real outcome of a variant, or None.

    A law needs published scores of the variant's trials, or names the variant in full. A new material, which nobody has
    measured, has no law.
    """
    is_published = bool(published_baselines(variant))
    for law in read_toml(scoring_folder("bands") / "laws.toml", _Laws).law:
        names = law.variants.split()
        if variant in names or (
            is_published and any(fnmatchcase(variant, name) for name in names)
        ):
            return law
    return None


def carried_band(*, variant: str, positions_mm: ArrayLike) -> Band:
    """Return the band of a rigidly carried body: the given mean, and sigma from the published baseline.

    Sigma is constant in time. The mean over trials of the squared E_RMSE is the time-averaged variance of the vector
    deviation, so sigma_rms^2 = mean^2 + std^2 of the published E_RMSE. This is exact if all three divide by the number
    of trials n. If std and sigma divide by n - 1, sigma_rms^2 is larger by mean^2 / (n - 1). That term is left out, as
    n is not published; for n = 20, sigma is then at most 2.6 % too small. The split of the variance over x, y and z is
    not published either. It is taken as equal, sigma_rms / sqrt(3) each.

    Args:
        variant: Variant with a law of kind `carried`.
        positions_mm: Position of the carried body by the law and the scene's driver [mm], shape [published frame
            count, 3].

    Returns:
        Band of grade `law` over x, y and z [mm]. Every frame counts as measured.
    """
    law, baseline = law_for(variant), published_baselines(variant).get("rmse")
    if not isinstance(law, CarriedLaw) or baseline is None:
        carried = [
            name
            for name in published_variants()
            if isinstance(law_for(name), CarriedLaw)
        ]
        raise UnknownNameError("carried variant", variant, carried)
    positions = np.asarray(positions_mm, dtype=np.float64)
    if positions.shape != (baseline.frames, 3):
        raise ShapeError(
            f"positions_mm has shape {positions.shape}; {(baseline.frames, 3)} is needed for {variant}"
        )
    if not np.isfinite(positions).all():
        raise ShapeError("positions_mm holds a value that is not finite")
    sigma_rms = math.hypot(baseline.mean, baseline.std or 0.0)
    return Band(
        grade=BandGrade.LAW,
        sigma_source=SigmaSource.BASELINE,
        unit=baseline.unit,
        coordinates=("x", "y", "z"),
        projection=np.eye(3),
        mean=positions,
        sigma=np.full(positions.shape, sigma_rms / math.sqrt(3)),
        measured=np.ones(len(positions), dtype=bool),
        trial_count=None,
        source=f"{law.body} carried by {law.carrier}, {law.condition}; sigma from the paper's Table 5",
        is_exact=True,
    )


def uncontacted_band(
    law: UncontactedLaw,
    *,
    positions_mm: ArrayLike,
    uncertainty_mm: ArrayLike | None = None,
) -> Band:
    """Return the band of a motion that a law gives until an event, and that is not known from then on.

    Sigma is the uncertainty of a measured coordinate, as the scatter of real trials before the event is not published.
    That of the law adds in quadrature. The published baseline covers the whole motion, so that distances are not
    divided by it.

    Args:
        law: The law.
        positions_mm: Position of the body by the law [mm], shape [frame_count, 3]; NaN from the event on.
        uncertainty_mm: Standard uncertainty of the law at each frame [mm], same shape; None for 0.

    Returns:
        Band of grade `law` over x, y and z [mm]. Frames before the event count as measured.
    """
    positions = np.asarray(positions_mm, dtype=np.float64)
    sigma = np.hypot(
        law.sigma_mm,
        np.zeros(positions.shape) if uncertainty_mm is None else uncertainty_mm,
    )
    known = np.isfinite(positions)
    nominal = "the nominal uncertainty of motion capture"
    return Band(
        grade=BandGrade.LAW,
        sigma_source=SigmaSource.MEASUREMENT,
        unit="mm",
        coordinates=("x", "y", "z"),
        projection=np.eye(3),
        mean=positions,
        sigma=sigma,
        measured=np.asarray(known.all(axis=1)),
        trial_count=None,
        source=f"{law.body}: {law.condition}; sigma is {nominal}{'' if uncertainty_mm is None else ' and of the law'}",
        uncertainty=np.where(known, sigma, np.nan),
        normalized_by_baseline=False,
        is_exact=isinstance(law, FlightLaw | SlideLaw | SwingLaw),
    )


def uniaxial_band(
    law: UniaxialLaw,
    *,
    variant: str,
    areas_mm2: ArrayLike,
    uncertainty_mm2: ArrayLike,
    measurement_mm2: float,
) -> Band:
    """Return the band of the face areas of a strained bar.

    Sigma is from the published baseline where there is one, as in `carried_band`, else that of the measurement.

    Args:
        law: The law.
        variant: Name of the variant.
        areas_mm2: Area of each face by the law [mm^2], shape [frame_count, face_count].
        uncertainty_mm2: Standard uncertainty of the law [mm^2], same shape.
        measurement_mm2: 1-sigma uncertainty of a measured area [mm^2].
    """
    areas, baseline = (
        np.asarray(areas_mm2, dtype=np.float64),
        published_baselines(variant).get("rmse"),
    )
    if baseline is None:
        sigma = np.hypot(measurement_mm2, uncertainty_mm2)
    else:
        sigma = np.full(
            areas.shape,
            math.hypot(baseline.mean, baseline.std or 0.0) / math.sqrt(areas.shape[1]),
        )
    return Band(
        grade=BandGrade.LAW,
        sigma_source=SigmaSource.MEASUREMENT
        if baseline is None
        else SigmaSource.BASELINE,
        unit="mm^2",
        coordinates=tuple(f"face-{face}" for face in range(areas.shape[1])),
        projection=np.eye(areas.shape[1]),
        mean=areas,
        sigma=sigma,
        measured=np.ones(len(areas), dtype=bool),
        trial_count=None,
        source=f"{law.body} strained by {law.carrier}: {law.condition}",
        uncertainty=np.asarray(uncertainty_mm2),
    )


# --- events ----------------------------------------------------------------------------------------------------------


class EventQuantity(StrEnum):
    """What is compared of the swings of a cradle's last ball."""

    LEAVES = "leaves"
    """Time after the release at which the ball leaves the row."""
    RETURNS = "returns"
    """Time after the release at which it returns."""
    RESTS = "rests"
    """Duration of its rest until it leaves again."""


class RecordedEvents(FileModel):
    """Times of one kind of event in the recording of one trial.

    Attributes:
        variant: Variant that the recording shows.
        quantity: What the values are.
        values_s: Value of each swing, from the first one [s].
        sigma_s: 1-sigma uncertainty of each value [s].
        source: Recording and method.
    """

    variant: str
    quantity: EventQuantity
    values_s: Annotated[tuple[Positive, ...], Field(min_length=1)]
    sigma_s: Positive
    source: str


class _Events(FileModel):
    """The file `scoring/bands/events.toml`."""

    events: tuple[RecordedEvents, ...]


def recorded_events(variant: str) -> tuple[RecordedEvents, ...]:
    """Return the recorded events of a variant, which may be none."""
    known = read_toml(scoring_folder("bands") / "events.toml", _Events).events
    return tuple(events for events in known if events.variant == variant)
