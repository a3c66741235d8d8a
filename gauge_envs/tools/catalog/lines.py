"""What `gauge list` and `gauge show` print with `--json`, a line each."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

from gauge_envs.references.convergence import Convergence
from gauge_envs.references.kind import Kind
from gauge_envs.references.models import UnsolvedScene
from gauge_envs.references.published import Baseline
from gauge_envs.scene import Attachment, Contact
from gauge_envs.scoring.deformation import RealStatistic


class ExperimentFacts(TypedDict):
    """What is said of an experiment in any installation.

    Attributes:
        id: Gymnasium id.
        family: Name of the family.
        group: Kind of bodies.
        observable: What g(t) is.
        frames: Number of frames of 1/30 s.
        grade: What the reference is; see docs/scores.md.
    """

    id: str
    family: str
    group: str
    observable: str
    frames: int
    grade: Kind


class ListLine(ExperimentFacts):
    """An experiment.

    Attributes:
        imported: Whether real trials of it were imported.
        backends: What each engine lacks to run it; empty for an engine that can.
    """

    imported: bool
    backends: Mapping[str, Sequence[str]]


class SchemaLine(TypedDict):
    """A JSON Schema, as `gauge show NAME --schema` prints it."""

    name: str
    version: int


class AssetFacts(TypedDict):
    """The file that states a scene in place of the task file.

    Attributes:
        file: Its name.
        kind: Kind of file.
        sha256: Hash of the file.
        edited: Whether the scene differs from the calibrated one.
        changes: The differences.
    """

    file: str
    kind: str
    sha256: str
    edited: bool
    changes: Sequence[str]


class ObservableFacts(TypedDict):
    """What g(t) is, its unit, and the names of its coordinates."""

    kind: str
    unit: str
    coordinates: Sequence[str]


class ConstantFacts(TypedDict):
    """A constant with its source."""

    value: Any
    source: str


class ParameterSet(TypedDict):
    """A set of constants, and what it overrides."""

    summary: str
    values: Mapping[str, Any]


class DriverFacts(TypedDict):
    """A driven body.

    Attributes:
        body: Name of the body.
        provenance: Where its motion is from.
        imported: Whether it is a recorded motion that was imported.
        note: What is known of the motion.
        motions: The motions along or about axes, as in a task file.
    """

    body: str
    provenance: str
    imported: bool
    note: str
    motions: Sequence[Mapping[str, Any]]


class MarkerFacts(TypedDict):
    """Number of markers on bodies."""

    count: int


class SpaceEntry(TypedDict):
    """An entry of the action or of the observation.

    Attributes:
        entry: Key of the entry.
        whole: Shape of the entry.
        name: Part of it.
        shape: Shape of the part.
        low: Least value; null without bound.
        high: Largest value; null without bound.
        unit: Unit; 1 for a pure number.
        meaning: What it is.
    """

    entry: str
    whole: Sequence[int]
    name: str
    shape: Sequence[int]
    low: float
    high: float
    unit: str
    meaning: str


class ReferenceFacts(TypedDict):
    """What an experiment is or could be scored against.

    Attributes:
        grade: What the reference is; see docs/scores.md.
        trial_count: Number of real trials.
        single_shot: Whether it is the one trial of the same start.
        source: Its source.
        imported: Whether imported trials are in use.
        is_import_available: Whether there are imported trials.
        law: Condition of the law, where there is no other reference.
        sigma_source: Where the standard deviation of the band is from.
        known_frames: Number of frames with a mean.
        normalized_by_baseline: Whether scores are normalized by the published baseline.
        impossible: Published scores that cannot be right; empty without.
        withheld: Why the band is not scored on by default.
        unsolved: Why the scene has no solution.
        reward: The reward of a step.
        deformation: Real statistics of deformation, with which every run is compared beside its score.
    """

    grade: Kind
    trial_count: int | None
    single_shot: bool
    source: str | None
    imported: bool
    is_import_available: bool
    law: str | None
    sigma_source: str | None
    known_frames: int | None
    normalized_by_baseline: bool | None
    impossible: str
    withheld: str | None
    unsolved: UnsolvedScene | None
    reward: str
    deformation: Sequence[RealStatistic]


class EngineFacts(TypedDict):
    """What an installed engine says of an experiment.

    Attributes:
        engine: Name of the engine.
        missing: Features of the scene that it lacks.
        fault: Why it does not run here.
        preset: Default preset of the scene.
        timestep_s: Default time step [s].
        convergence: What other settings change, by setting.
    """

    engine: str
    missing: Sequence[str]
    fault: str | None
    preset: str | None
    timestep_s: float | None
    convergence: Mapping[str, Convergence]


class LimitFacts(TypedDict):
    """What is known to be wrong or uncertain, and the study that shows it."""

    text: str
    study: str | None


class ShowLine(TypedDict):
    """All that defines an experiment, with the source of each number.

    Attributes:
        id: Gymnasium id.
        title: Title.
        summary: What happens, in a sentence.
        group: Kind of bodies; null for an experiment file.
        evaluates: What is evaluated.
        source: Where the experiment is described.
        constants: Constants of each body with their sources.
        parameter_sets: Sets of constants by name.
        subtask: Title of the subtask.
        provenance: Source of each number of the task file, by its place.
        decisions: What the sources leave open, and what was chosen.
        asset: File that states the scene; null for the task file.
        frames: Number of frames of 1/30 s.
        duration_s: Duration [s].
        observable: What g(t) is.
        bodies: Bodies: `name`, `kind`, `recorded`, pose, and what `gauge_envs.scene` states of the kind.
        contacts: Constants of pairs of bodies.
        joints: Joints, with the fields of their class in `gauge_envs.scene`.
        attachments: Deformable bodies that are held.
        drivers: Driven bodies.
        air: Constants of the air.
        markers: Markers on bodies.
        action: Entries of the action.
        observation: Entries of the observation.
        reference: What it is scored against.
        baselines: Published scores.
        engines: What each engine says of it.
        limits: What is known to be wrong or uncertain.
    """

    id: str
    title: str
    summary: str
    group: str | None
    evaluates: Sequence[str]
    source: Mapping[str, str]
    constants: Mapping[str, Mapping[str, ConstantFacts]]
    parameter_sets: Mapping[str, ParameterSet]
    subtask: str | None
    provenance: Mapping[str, str]
    decisions: Sequence[str]
    asset: AssetFacts | None
    frames: int
    duration_s: float
    observable: ObservableFacts
    bodies: Sequence[Mapping[str, Any]]
    contacts: Sequence[Contact]
    joints: Sequence[Mapping[str, Any]]
    attachments: Sequence[Attachment]
    drivers: Sequence[DriverFacts]
    air: Mapping[str, float] | None
    markers: MarkerFacts | None
    action: Sequence[SpaceEntry]
    observation: Sequence[SpaceEntry]
    reference: ReferenceFacts
    baselines: Sequence[Baseline]
    engines: Sequence[EngineFacts]
    limits: Sequence[LimitFacts]


class LimitOfTask(TypedDict):
    """The most that a law allows, with its standard uncertainty and their sources."""

    quantity: str
    unit: str
    value: float
    sigma: float
    law: str
    sigma_source: str


class ControlLine(TypedDict):
    """What defines a control task.

    Attributes:
        id: Gymnasium id.
        scene: Id of the experiment whose scene it has.
        duration_s: Duration [s].
        observed: What each entry of the observation is.
        limit: What the law allows.
        task: What is to be done and what is rewarded.
    """

    id: str
    scene: str
    duration_s: float
    observed: Sequence[str]
    limit: LimitOfTask
    task: str


Show = ShowLine | ControlLine
"""A line of `gauge show`."""
