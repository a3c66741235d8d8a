"""JSON lines of `gauge list` and `gauge show`."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

from gauge_envs.references.band import RecordedEvent
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import Baseline
from gauge_envs.scene import Attachment, Contact

Values = Mapping[str, Any]
"""A small table of named values."""


class ListLine(TypedDict):
    """An experiment.

    Attributes:
        id: Gymnasium id.
        family: Name of the family.
        group: Kind of bodies.
        observable: Quantity g(t).
        frames: Number of frames of 1/30 s.
        kind: Kind of the reference.
        imported: Whether its real trials are imported.
        backends: Missing features of each engine; empty for an engine that can run it.
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
    """A JSON Schema; `gauge show NAME --schema` prints it.

    Attributes:
        name: Words of the command whose output it describes.
        version: Version of the output.
    """

    name: str
    version: int


class ObservableFacts(TypedDict):
    """Quantity g(t).

    Attributes:
        kind: Name of the quantity.
        unit: Unit of its values.
        coordinates: Names of its coordinates.
    """

    kind: str
    unit: str
    coordinates: Sequence[str]


class ReferenceFacts(TypedDict):
    """Reference of an experiment.

    Attributes:
        kind: Kind of the reference motion.
        unit: Unit of `standard_uncertainty` and `zero_motion_distance`.
        compared: Coordinates of the distance and of the reward.
        source: Source of the numbers, or the reason for a missing reference.
        licence: Licence of the data.
        trial_count: Number of real trials.
        single_shot: Whether the reference is the only trial with the same initial state.
        known_frames: Number of frames with a mean.
        standard_uncertainty: Standard uncertainty u of the mean.
        zero_motion_distance: Distance of a scene without motion.
        exact: Distance of the exact motion, divided by real trials, by parameter set.
        exact_source: Computation of the exact motion, or the reason for a missing one.
        events: Events with a real value.
        sees: Scores of MuJoCo with planted errors, and `answers` to them, for each metric; null if not measured.
        imported: Whether imported trials are used.
        impossible: Impossible published scores; empty without such scores.
        reward: Reward of a step.
    """

    kind: Kind
    unit: str | None
    compared: Sequence[str] | None
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
    """Complete description of an experiment, with the source of each number.

    Attributes:
        id: Gymnasium id.
        title: Title.
        summary: Description in a sentence.
        group: Kind of bodies, for example `rigid`.
        evaluates: Evaluated phenomena.
        source: Publication of the experiment.
        constants: `value` and `source` of each constant of each body.
        parameter_sets: `summary` and overriding `values` of each set of constants.
        subtask: Title of the subtask.
        provenance: Source of each number of the task file, by place.
        decisions: Choices for details that the sources do not specify.
        asset: File of the scene, with its changes; null for the task file.
        frames: Number of frames of 1/30 s.
        duration_s: Duration [s].
        observable: What is compared with the reference.
        bodies: Bodies: `name`, `kind`, `recorded`, pose, and the fields of their class in `gauge_envs.scene`.
        contacts: Constants of pairs of bodies.
        joints: Joints, with the fields of their class in `gauge_envs.scene`.
        attachments: Clamped deformable bodies.
        drivers: Driven bodies: `body`, `provenance`, `imported`, `note`, `motions`.
        gravity_m_per_s2: Gravity.
        air: Constants of the air.
        markers: Number of markers on bodies; null without markers.
        action: Entries of the action: name, shape, bounds, unit, meaning.
        observation: Entries of the observation, with the same fields.
        reference: Reference of the score.
        baselines: Published scores.
        engines: Support by each engine: `missing` features, `fault`, `preset`, `timestep_s`, `convergence`.
        limits: Known limits: `text`, and the `study` with the numbers.
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
    gravity_m_per_s2: float
    air: Mapping[str, float] | None
    markers: Values | None
    action: Sequence[Values]
    observation: Sequence[Values]
    reference: ReferenceFacts
    baselines: Sequence[Baseline]
    engines: Sequence[Values]
    limits: Sequence[Values]


class ControlLine(TypedDict):
    """Description of a control task.

    Attributes:
        id: Gymnasium id.
        scene: Id of the experiment with the same scene.
        duration_s: Duration [s].
        observed: Meaning of each entry of the observation.
        limit: Limit by the law: `quantity`, `unit`, `value`, `sigma` and their sources.
        return_limit: Largest sum of rewards that the law allows in an episode.
        task: Goal and reward.
    """

    id: str
    scene: str
    duration_s: float
    observed: Sequence[str]
    limit: Values
    return_limit: float
    task: str


Show = ShowLine | ControlLine
"""A line of `gauge show`."""
