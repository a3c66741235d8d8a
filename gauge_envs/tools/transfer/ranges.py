"""Ranges for domain randomization that data justify: each states what scatters, how often it was measured, and where.

Repeated trials of one thing scatter about a mean: their range covers 95 % of further ones (Student's t). Files, units
and pairs of materials differ for reasons that nobody measured, so no distribution is assumed: their range is from the
smallest to the largest value, and a further one lies inside with the chance (n - 1) / (n + 1).
"""

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache

import numpy as np
from pydantic import PositiveInt, TypeAdapter
from scipy.special import stdtrit

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.uncertain import UncertainParameter, uncertain_parameters
from gauge_envs.files import toml_document
from gauge_envs.references.sensitivities import input_uncertainties
from gauge_envs.references.tables import (
    FileModel,
    faults_of,
    read_content,
    scoring_folder,
)
from gauge_envs.scene.geometry import Positive

LEVEL = 0.95
"""Share of further trials that a range of trials covers."""

FEWEST = 3
"""Fewest values that make a range: of two, the smallest and largest hold a third of further ones."""

NOMINAL_FRICTIONS = (0.01, 0.1)
"""Coefficients that task files have where none was measured."""

SLIDES = "slope_slider_30deg_summary.toml"
DROPS = "bouncing_ball_summary.toml"
TABLES = "friction_tables.csv"


class Scatter(StrEnum):
    """What differs between the values of a range."""

    TRIALS = "trials"
    """Repeated trials of one thing."""
    FILES = "files"
    """Recordings of one joint, fitted one by one."""
    UNITS = "units"
    """Parts of one type."""
    LAWS = "laws"
    """Laws that were fitted to the same recordings of one joint."""
    PAIRS = "pairs"
    """Pairs of materials."""
    STATED = "stated"
    """Nothing that was measured: the user states the range."""


@dataclass(frozen=True, kw_only=True)
class JustifiedRange:
    """Range of one constant, from which a training may draw uniformly.

    Attributes:
        part: Body whose constant it is, as `cube`; `joints` for all joints, `contact` for a robot on its ground.
        constant: Name of the constant, as `friction` or `kp_n_m_per_rad`.
        low: Lower end.
        high: Upper end.
        unit: Unit of both; `1` for a ratio.
        operation: `abs` for a value, `scale` for a factor on the model's value, `add` for what is added to it.
        scatter: What differs between the values that made it.
        count: Number of these values.
        inside: Chance that a further value lies inside; None where one joint alone was measured, or nothing was.
        source: Origin of the values.
    """

    part: str
    constant: str
    low: float
    high: float
    unit: str
    operation: str = "abs"
    scatter: Scatter
    count: int
    inside: float | None
    source: str

    @property
    def name(self) -> str:
        """Name for tables, as `cube.friction`."""
        return f"{self.part}.{self.constant}"

    @property
    def middle(self) -> float:
        """Centre of the range."""
        return 0.5 * (self.low + self.high)


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """A constant without a range.

    Attributes:
        name: Name for tables, as `cube.restitution`.
        reason: Why no range is justified, and what would give one.
    """

    name: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Justified:
    """Ranges of an id or a robot file, and what has none.

    Attributes:
        subject: Id or file.
        ranges: The ranges.
        left_out: What has none.
        joints: Joints to which the ranges of `joints` apply.
    """

    subject: str
    ranges: tuple[JustifiedRange, ...]
    left_out: tuple[LeftOut, ...]
    joints: tuple[str, ...] = ()


# --- values ----------------------------------------------------------------------------------------------------------


class Measured(FileModel):
    """Values of one constant (`scoring/ranges.toml`)."""

    kind: Scatter
    unit: str
    source: str
    values: tuple[Positive, ...] = ()
    factor: Positive | None = None
    count: PositiveInt | None = None


@cache
def measured_constants() -> Mapping[str, Mapping[str, Measured]]:
    """Return constants with several values, by material of an id and name of the constant."""
    file = scoring_folder("ranges.toml")
    with faults_of(file):
        return TypeAdapter(dict[str, dict[str, Measured]]).validate_python(
            toml_document(read_content(file))
        )


def covering(mean: float, std: float, count: int) -> tuple[float, float]:
    """Return the ends of the interval that covers 95 % of further trials, from those of `count` trials."""
    half = (
        float(stdtrit(count - 1, 0.5 + 0.5 * LEVEL))
        * std
        * math.sqrt(1.0 + 1.0 / count)
    )
    return max(mean - half, 0.0), mean + half


def _range_of(part: str, constant: str, one: Measured) -> JustifiedRange | LeftOut:
    """Return the range of values, or why they make none."""
    if one.factor is not None:
        assert one.count is not None, "a factor states how often it was measured"
        return JustifiedRange(
            part=part, constant=constant, low=1.0 / one.factor, high=one.factor, unit="1", operation="scale",
            scatter=one.kind, count=one.count, inside=_chance(one.count), source=one.source,
        )  # fmt: skip
    count = one.count or len(one.values)
    if count < FEWEST:
        shown = " and ".join(f"{value:.3g}" for value in one.values)
        return LeftOut(
            name=f"{part}.{constant}",
            reason=f"{count} values, {shown} {one.unit} ({one.source}): a range needs {FEWEST}",
        )
    low, high = min(one.values), max(one.values)
    # Laws of one joint say nothing about another joint.
    inside = None if one.kind is Scatter.LAWS else _chance(count)
    if one.kind is Scatter.TRIALS:
        low, high = covering(
            float(np.mean(one.values)), float(np.std(one.values, ddof=1)), count
        )
        inside = LEVEL
    return JustifiedRange(
        part=part, constant=constant, low=low, high=high, unit=one.unit, scatter=one.kind, count=count,
        inside=inside, source=one.source,
    )  # fmt: skip


def _chance(count: int) -> float:
    """Return the chance that a further value of any distribution lies between the smallest and the largest of some."""
    return (count - 1) / (count + 1)


def _trials(part: str, constant: str, file: str, table: str, key: str) -> JustifiedRange:  # fmt: skip
    """Return the range of single real trials whose mean and scatter a file of facts has."""
    path = scoring_folder("facts") / file
    document = toml_document(read_content(path))
    facts = document[table] if table else document
    mean, std, count = facts[key]["mean"], facts[key]["std"], facts["trial_count"]
    low, high = covering(mean, std, count)
    unit = "m" if key.endswith("_m") else "1"
    return JustifiedRange(
        part=part, constant=constant, low=low, high=high, unit=unit, scatter=Scatter.TRIALS, count=count,
        inside=LEVEL, source=f"single real trials (scoring/facts/{file}, {key})",
    )  # fmt: skip


def slides_of_one_pair() -> tuple[JustifiedRange, ...]:
    """Return the friction of single slides of each measured pair: a cube of wood, plastic or metal on one board."""
    return tuple(
        _trials(f"{material} on wood", "friction", SLIDES, material, "friction")
        for material in ("wood", "plastic", "metal")
    )


PAIRS = (
    *(("SlopeSlider", "cube", one) for one in ("wood", "plastic", "metal")),
    *(("Turntable", "cube", one) for one in ("wood", "plastic", "metal")),
    *(("SlopeContact", "teh", one) for one in ("wood", "plastic")),
    ("BouncingBall", "ball", "rubber"),
)
"""Pairs of the benchmark whose friction is calibrated: family of the task file, body and material."""


@cache
def friction_of_materials() -> JustifiedRange:
    """Return the friction of all pairs of materials that this package has: what an unknown floor may have."""
    values = []
    for family, body, material in PAIRS:
        value = task_spec(family).constants_of(body, material, None)["friction"]
        assert value is not None, "task files state it"
        values.append([float(value)])
    text = read_content(scoring_folder("facts") / TABLES).decode()
    for row in csv.DictReader(text.splitlines()):
        stated = [row[key] for key in ("static", "dynamic") if row[key]]
        if stated:
            values.append([float(end) for ends in stated for end in ends.split(" to ")])
    return JustifiedRange(
        part="contact", constant="friction", low=min(map(min, values)), high=max(map(max, values)), unit="1",
        scatter=Scatter.PAIRS, count=len(values), inside=_chance(len(values)),
        source=f"all pairs of materials here: {len(PAIRS)} calibrated ones (tasks), and tables "
        f"(scoring/facts/{TABLES}); the pair of this contact is not known",
    )  # fmt: skip


# --- ids -------------------------------------------------------------------------------------------------------------


def justified_ranges(
    variant: str, *, payload_kg: tuple[float, float] | None = None, body: str = ""
) -> Justified:
    """Return the ranges that data justify for the constants of an id.

    Args:
        variant: Variant or id.
        payload_kg: Smallest and largest mass that is added to `body` [kg]; None for none.
        body: Body that carries the payload.
    """
    experiment = load_experiment(variant)
    owners = [
        one.key.rpartition(".")[0]
        for one in uncertain_parameters(experiment)
        if one.key.rpartition(".")[2] in input_uncertainties().joint
    ]
    names = {one.name for one in experiment.scene.bodies}
    found = [*_constants(experiment), payload(payload_kg, body, names, experiment.id)]
    ranges = [one for one in found if isinstance(one, JustifiedRange)]
    left_out = [one for one in found if isinstance(one, LeftOut)]
    if experiment.scene.deformables:
        left_out.append(
            LeftOut(
                name="deformable bodies",
                reason="stiffness, damping and density were calibrated once: nothing tells how they scatter",
            )
        )
    return Justified(
        subject=experiment.id,
        ranges=tuple(ranges),
        left_out=tuple(left_out),
        joints=tuple(dict.fromkeys(owners)),
    )


def payload(
    payload_kg: tuple[float, float] | None, body: str, bodies: set[str], subject: str
) -> JustifiedRange | LeftOut:
    """Return the mass that the user states for a body; or that masses have no range."""
    if payload_kg is None:
        return LeftOut(
            name="mass",
            reason="masses are stated once, and rounding of digits is no scatter: state what a body carries "
            "(--payload, --body)",
        )
    if body not in bodies:
        known = ", ".join(sorted(bodies))
        raise ParameterError(
            f"{subject}: --payload needs the body that carries it: --body, one of {known}; {body or 'none'} is given"
        )
    low, high = payload_kg
    if not 0.0 <= low < high < math.inf:
        raise ParameterError(
            f"--payload {low:g},{high:g}: expected the smallest and the largest mass that is added, as 0,0.5 [kg]"
        )
    return JustifiedRange(
        part=body, constant="mass_kg", low=low, high=high, unit="kg", operation="add", scatter=Scatter.STATED,
        count=0, inside=None, source="stated by the user",
    )  # fmt: skip


def _constants(experiment: TaskExperiment) -> Iterator[JustifiedRange | LeftOut]:
    seen: set[str] = set()
    for one in uncertain_parameters(experiment):
        part, _, constant = one.key.rpartition(".")
        if constant == "friction":
            yield _friction(experiment, part, one)
        elif constant == "restitution":
            yield _restitution(experiment, part)
        elif constant in input_uncertainties().joint and constant not in seen:
            seen.add(constant)
            yield _joint(experiment, constant)
    yield _start(experiment)


def _friction(
    experiment: TaskExperiment, part: str, one: UncertainParameter
) -> JustifiedRange | LeftOut:
    """Return the friction of a pair: from its own trials, else from how far calibrations of other pairs are off."""
    variant, name = experiment.variant, one.name
    material = variant.material or ""
    if variant.family == "SlopeSlider":
        return _trials(part, "friction", SLIDES, material, "friction")
    measured = measured_constants().get(material, {}).get("friction")
    if measured is not None and part == "cube":
        return _range_of(part, "friction", measured)
    assert isinstance(one.value, float)
    origin = experiment.spec.provenance_of(f"constants.{part}.{material}.friction")
    if experiment.spec.group != "rigid" or not origin.startswith("metadata"):
        return LeftOut(
            name=name,
            reason=f"no trial of this pair was compared with its value ({origin}): measure it",
        )
    if one.value in NOMINAL_FRICTIONS:
        return LeftOut(
            name=name, reason=f"{one.value:g} is nominal: this pair was not measured"
        )
    known = input_uncertainties().friction
    count = len(known.relative) - 1
    half = float(stdtrit(count, 0.5 + 0.5 * LEVEL)) * known.relative["other"]
    return JustifiedRange(
        part=part, constant="friction", low=one.value * (1.0 - half), high=one.value * (1.0 + half), unit="1",
        scatter=Scatter.PAIRS, count=count, inside=LEVEL,
        source="the calibration is as far from this pair as those of three others are from their trials "
        "(scoring/uncertainties.toml, friction)",
    )  # fmt: skip


def _restitution(experiment: TaskExperiment, part: str) -> JustifiedRange | LeftOut:
    if experiment.variant.family == "BouncingBall":
        return _trials(part, "restitution", DROPS, "", "rebound_ratio")
    return LeftOut(
        name=f"{part}.restitution",
        reason="no rebound of this pair was measured; that of a rubber ball on wood says nothing about it",
    )


def _joint(experiment: TaskExperiment, constant: str) -> JustifiedRange | LeftOut:
    one = measured_constants().get(experiment.variant.material or "", {}).get(constant)
    if one is None:
        return LeftOut(
            name=f"joints.{constant}",
            reason="it was fitted once, to all recordings together: fit each file alone (gauge recipe joint)",
        )
    return _range_of("joints", constant, one)


def _start(experiment: TaskExperiment) -> JustifiedRange | LeftOut:
    if experiment.variant.family == "BouncingBall":
        height = _trials("ball", "position_m", DROPS, "", "start_height_m")
        half = 0.5 * (height.high - height.low)
        return replace(
            height, low=-half, high=half, operation="add",
            source=f"{height.source}; along z, horizontal places are not known",
        )  # fmt: skip
    if (experiment.variant.family, experiment.variant.subtask) == ("SlopeSlider", "2"):
        file = f"{experiment.variant.name}.csv"
        text = read_content(scoring_folder("trials") / file).decode()
        _, first, *_ = csv.reader(text.splitlines())
        places_m = 1e-3 * np.array(first[1:], dtype=float)
        half = covering(0.0, float(places_m.std(ddof=1)), len(places_m))[1]
        return JustifiedRange(
            part="cube", constant="position_m", low=-half, high=half, unit="m", operation="add",
            scatter=Scatter.TRIALS, count=len(places_m), inside=LEVEL,
            source=f"first places of single real trials (scoring/trials/{file}); downhill, places across are not known",
        )  # fmt: skip
    return LeftOut(
        name="start",
        reason="no repeated placement of these bodies was recorded: state how well you place them",
    )


def ranges_like(names: Sequence[str]) -> tuple[list[JustifiedRange], list[LeftOut]]:
    """Return the ranges of ids for a robot with a contact or joints like theirs: friction, restitution, joints."""
    ranges: dict[str, JustifiedRange] = {}
    left_out: dict[str, LeftOut] = {}
    for name in names:
        found = justified_ranges(name)
        for one in found.ranges:
            is_contact = one.constant in ("friction", "restitution")
            if not is_contact and one.part != "joints":
                continue
            new = replace(
                one,
                part="contact" if is_contact else "joints",
                source=f"as {name}: {one.source}",
            )
            if new.name in ranges:
                raise ParameterError(
                    f"--like {','.join(names)}: two of them state {new.name}; leave one out"
                )
            ranges[new.name] = new
        for gone in found.left_out:
            part, _, constant = gone.name.rpartition(".")
            where = "joints" if part == "joints" else "contact"
            if part and not constant.startswith("mass"):
                left_out[f"{where}.{constant}"] = replace(
                    gone, name=f"{where}.{constant}", reason=f"as {name}: {gone.reason}"
                )
    return list(ranges.values()), [
        one for key, one in left_out.items() if key not in ranges
    ]
