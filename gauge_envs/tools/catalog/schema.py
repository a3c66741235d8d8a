"""What `gauge list` and `gauge show` print with `--json`, a line each."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

from gauge_envs.references.band import RecordedEvent
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import Baseline
from gauge_envs.scene import Attachment, Contact

Values = Mapping[str, Any]
"""A small table, whose keys name its values."""


class ListLine(TypedDict):
    """An experiment.

    Attributes:
        id: Gymnasium id.
        family: Name of the family.
        group: Kind of bodies.
        observable: What g(t) is.
        frames: Number of frames of 1/30 s.
        kind: Kind of its reference.
        imported: Whether real trials of it were imported.
        backends: What each engine lacks to run it; empty for an engine that can.
    """

    id: str
    family: str
    group: str
    observable: str
    frames: int
    kind: Kind
    imported: bool
    backends: Mapping[str, Sequence[str]]


class SchemaLine(TypedDict):
    """A JSON Schema, as `gauge show NAME --schema` prints it."""

    name: str
    version: int


class ObservableFacts(TypedDict):
    """What g(t) is, its unit, and the names of its coordinates."""

    kind: str
    unit: str
    coordinates: Sequence[str]


class ReferenceFacts(TypedDict):
    """What an experiment is scored against.

    Attributes:
        kind: What the reference motion is.
        unit: Unit of `standard_uncertainty` and `zero_motion_distance`.
        source: Where the numbers are from, or why there is no reference.
        licence: Licence of the data.
        trial_count: Number of real trials.
        single_shot: Whether it is the one trial of the same start.
        known_frames: Number of frames with a mean.
        standard_uncertainty: Standard uncertainty u of the mean.
        zero_motion_distance: Distance of a scene in which nothing moves.
        exact: Distance over real trials of an exact solution, by parameter set.
        exact_source: How the exact solution was computed.
        events: Events with a real value.
        sees: The score on MuJoCo with changed motions and constants, for each metric; null was not measured.
        imported: Whether imported trials are in use.
        impossible: Published scores that cannot be right; empty without.
        reward: The reward of a step.
    """

    kind: Kind
    unit: str | None
    source: str | None
    licence: str | None
    trial_count: int | None
    single_shot: bool
    known_frames: int | None
    standard_uncertainty: float | None
    zero_motion_distance: float | None
    exact: Mapping[str, float]
    exact_source: str | None
    events: Sequence[RecordedEvent]
    sees: Sequence[Values]
    imported: bool
    impossible: str
    reward: str


class ShowLine(TypedDict):
    """All that defines an experiment, with the source of each number.

    Attributes:
        id: Gymnasium id.
        title: Title.
        summary: What happens, in a sentence.
        group: Kind of bodies; as `rigid`.
        evaluates: What is evaluated.
        source: Where the experiment is described.
        constants: `value` and `source` of each constant of each body.
        parameter_sets: `summary` and overriding `values` of each set of constants.
        subtask: Title of the subtask.
        provenance: Source of each number of the task file, by its place.
        decisions: What the sources leave open, and what was chosen.
        asset: File that states the scene, with its changes; null for the task file.
        frames: Number of frames of 1/30 s.
        duration_s: Duration [s].
        observable: What g(t) is.
        bodies: Bodies: `name`, `kind`, `recorded`, pose, and what `gauge_envs.scene` states of the kind.
        contacts: Constants of pairs of bodies.
        joints: Joints, with the fields of their class in `gauge_envs.scene`.
        attachments: Deformable bodies that are held.
        drivers: Driven bodies: `body`, `provenance`, `imported`, `note`, `motions`.
        air: Constants of the air.
        markers: Number of markers on bodies; null without.
        action: Entries of the action: name, shape, bounds, unit, meaning.
        observation: Entries of the observation, in the same way.
        reference: What it is scored against.
        baselines: Published scores.
        engines: What each engine says: `missing` features, `fault`, `preset`, `timestep_s`, `convergence`.
        limits: What is known to be wrong or uncertain: `text`, and the `study` that shows it.
    """

    id: str
    title: str
    summary: str
    group: str | None
    evaluates: Sequence[str]
    source: Mapping[str, str]
    constants: Mapping[str, Mapping[str, Values]]
    parameter_sets: Mapping[str, Values]
    subtask: str | None
    provenance: Mapping[str, str]
    decisions: Sequence[str]
    asset: Values | None
    frames: int
    duration_s: float
    observable: ObservableFacts
    bodies: Sequence[Values]
    contacts: Sequence[Contact]
    joints: Sequence[Values]
    attachments: Sequence[Attachment]
    drivers: Sequence[Values]
    air: Mapping[str, float] | None
    markers: Values | None
    action: Sequence[Values]
    observation: Sequence[Values]
    reference: ReferenceFacts
    baselines: Sequence[Baseline]
    engines: Sequence[Values]
    limits: Sequence[Values]


class ControlLine(TypedDict):
    """What defines a control task.

    Attributes:
        id: Gymnasium id.
        scene: Id of the experiment whose scene it has.
        duration_s: Duration [s].
        observed: What each entry of the observation is.
        limit: What the law allows: `quantity`, `unit`, `value`, `sigma` and their sources.
        task: What is to be done and what is rewarded.
    """

    id: str
    scene: str
    duration_s: float
    observed: Sequence[str]
    limit: Values
    task: str


Show = ShowLine | ControlLine
"""A line of `gauge show`."""
