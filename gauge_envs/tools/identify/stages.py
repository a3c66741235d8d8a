"""Fit of joints to logs in two stages.

Stage 1 fits short parts of the logs, each from its own start, so that a wrong period cannot slip by a whole swing.
Stage 2 goes on with long parts; the starts of joints without servos are then unknowns too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.servo_friction import (
    DIRECTED,
    DIRECTED_STRIBECK,
    IN_ONE,
    LOAD,
    LOAD_STRIBECK,
    QUADRATIC_LOAD,
    SERVO_FRICTION,
    STRIBECK,
)
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.model_files import joint_names
from gauge_envs.tools.identify.problem import (
    CLOSE,
    LOST_RAD,
    MOST_STEPS,
    SERVO_CLOSE,
    Problem,
)
from gauge_envs.tools.identify.rig import (
    BACKLASH,
    DYNAMICS,
    LIMIT,
    OFFSET,
    SERVO,
    Machine,
)

FREE_PARTS_S, SERVO_PARTS_S = (0.6, np.inf), (5.0, 20.0)
"""Longest part of a log in both stages [s]; a servo forgets its start."""

FIRST_STAGE_S = 15.0
"""About how much of the logs stage 1 uses, evenly spread [s]: it seeks the neighbourhood alone."""

COARSE_S = 0.002
"""Step up to which stage 1 and comparisons of laws multiply a shorter one, and least time between the samples of
stage 1 [s].
"""

QUADRATIC = DYNAMICS[3]


@dataclass(frozen=True)
class Fit:
    """Least squares of logs.

    Attributes:
        problem: The problem of stage 2.
        unknowns: Its unknowns.
        simulations: Number of parts of logs that were simulated.
    """

    problem: Problem
    unknowns: FloatArray
    simulations: int = 0

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the unknowns, shape [unknown_count, unknown_count]."""
        return self.problem.covariance(self.unknowns)

    @property
    def of_joints(self) -> FloatArray:
        """Unknowns of joints, shape [kind_count, J]."""
        kinds, joints = self.problem.kinds, self.problem.joints
        return self.unknowns[: kinds * joints].reshape(kinds, joints)

    @property
    def misfit(self) -> float:
        """Sum of the squared errors [rad^2]."""
        return float(self.problem.squares(self.unknowns).sum())

    def predicted(self, log: Log) -> FloatArray:
        """Return simulated less measured angles of a log from its recorded start [rad], shape [N, J]."""
        terms, zero, _ = self.problem.unknowns(self.unknowns)
        angles, rates = log.start()
        try:
            simulated = self.problem.machine.angles(log, terms, (angles - zero, rates))
        except DivergedError:
            return np.full(log.position_rad.shape, LOST_RAD)
        return zero + simulated - log.position_rad


@dataclass(frozen=True, kw_only=True)
class Fitter:
    """Fits numbers of joints to logs.

    Attributes:
        machine: The joints on an engine.
        known: Numbers that stay, as from a bench: of all joints, or of one as `elbow.kp_n_m_per_rad`.
        part_s: Longest part of a log in stage 2 [s]; None is 20 s for servos and the whole log for others.
    """

    machine: Machine
    known: Mapping[str, float]
    part_s: float | None = None

    def coarser(self) -> "Fitter":
        """Return the same with the step times a whole number, up to `COARSE_S`, or itself."""
        step_s = self.machine.timestep_s
        factor = int(COARSE_S / step_s + 1e-9)
        if factor < 2:
            return self
        return replace(self, machine=self.machine.with_step(factor * step_s))

    def fit(
        self,
        logs: Sequence[Log],
        names: Sequence[str],
        *,
        first: Fit | None = None,
        tolerance: float | None = None,
        most_steps: int = MOST_STEPS,
        progress: Callable[[str], None] = lambda text: None,
    ) -> Fit:
        """Fit numbers to logs in two stages, or in the second alone from another fit.

        Args:
            logs: The logs.
            names: The numbers, the known ones among them.
            first: Another fit.
            tolerance: Relative change of the unknowns at which stage 2 ends.
            most_steps: Most steps of stage 2.
            progress: Called with what is being done.
        """
        servo = logs[0].command_rad is not None
        short, long = self._stages(logs, names)
        if first is None:
            progress(f"{len(short.parts)} short parts of {len(logs)} logs")
            unknowns = self._neighbourhood(short)
        else:
            unknowns = self._from(first, long)
        progress(f"{len(long.parts)} long parts")
        if long.free_starts:
            starts = np.zeros(2 * len(long.parts) * long.joints)
            if first is not None and long.has_parts_of(first.problem):
                starts = first.unknowns[-starts.size :]
            unknowns = np.concatenate([unknowns, starts])
        tolerance = tolerance or (SERVO_CLOSE if servo else CLOSE)
        unknowns = long.solved(unknowns, tolerance, most_steps)
        return Fit(long, unknowns, short.simulations + long.simulations)

    def _neighbourhood(self, problem: Problem) -> FloatArray:
        """Return the unknowns of stage 1, by coarser steps unless the engine diverges with these."""
        fitter = self.coarser()
        if fitter is not self:
            coarse = replace(
                problem,
                machine=fitter.machine,
                parts=[part.thinned(COARSE_S) for part in problem.parts],
            )
            unknowns = coarse.neighbourhood()
            problem.simulations = coarse.simulations
            if not coarse.diverges(unknowns):
                return unknowns
        return problem.neighbourhood()

    def _stages(
        self, logs: Sequence[Log], names: Sequence[str]
    ) -> tuple[Problem, Problem]:
        """Return the problems of both stages: short parts of logs, and long ones."""
        servo = logs[0].command_rad is not None
        terms = guessed(self.machine, names, self.known)
        sizes = np.array([[one[name] for one in terms] for name in names])
        fixed = np.full(sizes.shape, np.nan)
        joints = joint_names(logs[0], len(terms))
        for key, value in self.known.items():
            joint, _, name = key.rpartition(".")
            columns = [joints.index(joint)] if joint else range(len(joints))
            fixed[names.index(name), columns] = value
        first_s, long_s = SERVO_PARTS_S if servo else FREE_PARTS_S
        short, long = parts_of(logs, first_s, self.part_s or long_s)
        problem = partial(
            Problem,
            self.machine,
            names=tuple(names),
            sizes=sizes,
            zero=len(terms) == 1 and not servo,
            fixed=fixed,
        )
        return (
            problem(short, [part.start() for part in short], free_starts=False),
            problem(long, [part.start() for part in long], free_starts=not servo),
        )

    @staticmethod
    def _from(first: Fit, problem: Problem) -> FloatArray:
        """Return the unknowns of joints that a problem starts with after another fit."""
        known = first.of_joints
        rows = dict(zip(first.problem.names, known, strict=False))
        rows |= {name: rows[one] for name, one in IN_ONE.items() if one in rows}
        guess = [rows.get(name, np.ones(problem.joints)) for name in problem.names]
        if problem.zero:
            guess.append(known[-1])
        unknowns = np.concatenate(guess)
        terms_of_law = {*SERVO_FRICTION} - {*STRIBECK[1:]}
        new = [name in terms_of_law and name not in rows for name in problem.names]
        return problem.shared_out(unknowns, np.array(new)) if any(new) else unknowns


def parts_of(
    logs: Sequence[Log], first_s: float, long_s: float
) -> tuple[list[Log], list[Log]]:
    """Return short parts of logs, about `FIRST_STAGE_S` of them, and long ones.

    Args:
        logs: The logs.
        first_s: Longest short part [s].
        long_s: Longest long part [s].

    Raises:
        ParameterError: Samples are too far apart for short parts.
    """
    for log in logs:
        apart_s = float(np.median(np.diff(log.times_s)))
        if 10.0 * apart_s > first_s:
            reason = f"samples are {apart_s:.3g} s apart, and at least 10 in {first_s:g} s are needed"
            raise ParameterError(f"{log.name}: {reason}; time_s is in seconds")
    short, long = (
        [part for log in logs for part in log.pieces(most_s) if len(part.times_s) >= 10]
        for most_s in (first_s, long_s)
    )
    step = max(1, round(len(short) * first_s / FIRST_STAGE_S))
    return short[::step], long


def guessed(
    machine: Machine, names: Sequence[str], known: Mapping[str, float]
) -> list[dict[str, float]]:
    """Return first guesses and sizes of numbers: what the scene states, or by the size of its loads.

    One size does for all joints of an arm: the search starts from seven stiffnesses, and its steps are relative.
    """
    inertia, load = machine.size()
    inertia += known.get(DYNAMICS[2], 0.0)
    weight = max(load, 40.0 * inertia)
    rate = float(np.sqrt(weight / inertia))
    # Without kv, the joint's viscous friction is all that damps a servo.
    damps = SERVO[0] in names and SERVO[1] not in names
    guesses = {
        "dry_friction_n_m": 0.01 * weight,
        "viscous_friction_n_m_s_per_rad": (1.0 if damps else 0.02) * weight / rate,
        "armature_kg_m2": 0.1 * inertia,
        QUADRATIC: 0.02 * weight / rate**2,
        "kp_n_m_per_rad": 10.0 * weight,
        "kv_n_m_s_per_rad": weight / rate,
        "delay_s": 0.02,
        LIMIT: weight,
        OFFSET: 0.5,
        BACKLASH: 0.01,
        **dict(zip(STRIBECK, (0.01 * weight, 0.2, 1.0), strict=True)),
        **dict.fromkeys((LOAD, *DIRECTED), 0.05),
        **dict.fromkeys((LOAD_STRIBECK, *DIRECTED_STRIBECK), 0.05),
        **dict.fromkeys(QUADRATIC_LOAD, 0.05 / weight),
    }
    return [
        {name: known[name] or guesses[name] for name in names}
        for known in machine.stated
    ]
