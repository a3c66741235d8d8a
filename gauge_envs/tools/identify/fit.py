"""Settings of joints from logs: least squares over an engine's own simulation, with 95 % intervals.

What the last stage leaves open of servos, and every open armature, is then set to what the scene states, one number of
a joint at a time, and the rest is fitted again.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from mujoco import MjSpec

from gauge_envs.backends.base import Backend, scene_support
from gauge_envs.backends.settings import with_drive_interval
from gauge_envs.backends.shared.joint_laws import without_laws
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.servo_friction import SERVO_FRICTION, TERMS
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.tools.identify.baselines import baselines
from gauge_envs.tools.identify.identified import Identified, Law, Setting
from gauge_envs.tools.identify.intervals import (
    SCALE,
    ZERO,
    between_files,
    errors_of_logs,
    errors_of_step,
    patterns_of,
    sensor_noise_of,
    settings_of,
    trades_of,
    with_load_error,
)
from gauge_envs.tools.identify.laws import (
    PLAY_LAW,
    SERVO_NAMES,
    asked_laws,
    compare_laws,
)
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.model_files import (
    joint_names,
    joints_of_model,
    joints_of_scene,
)
from gauge_envs.tools.identify.mujoco_joints import ModelJoints
from gauge_envs.tools.identify.problem import NEAR, SERVO_CLOSE, Problem
from gauge_envs.tools.identify.rig import (
    BACKLASH,
    DYNAMICS,
    LIMIT,
    OFFSET,
    SERVO,
    Machine,
    SceneJoints,
    check_joints,
    with_terms,
)
from gauge_envs.tools.identify.snippets import snippet_lines
from gauge_envs.tools.identify.stages import Fitter, guessed

PLAUSIBLE = 2.0
"""Distance, over half of the interval, up to which a fit with what the scene states is tried."""

AS_WELL, REFIT_STEPS = 1.01, 8
"""Error over that of the best fit up to which a fit with fewer numbers follows logs as well, and its most steps."""


def identify(
    engine: Backend,
    scene: Scene | MjSpec,
    logs: Sequence[Log],
    names: Sequence[str] | None = None,
    *,
    known: Mapping[str, float] | None = None,
    held_out: Sequence[Log] = (),
    load_error: float = 0.0,
    part_s: float | None = None,
    settings: Mapping[str, Any] | None = None,
    stack: str | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Identified:
    """Return the settings of joints with which an engine follows logs best.

    Args:
        engine: The engine.
        scene: A scene in which each hinge is at angle 0; its hinges are the joints of the logs, in its order. Or an
            MJCF model, whose joints have the names of the logs'; joints that no log names keep their pose.
        logs: Logs to fit.
        names: Numbers to identify, fields of `JointDynamics` and `Servo`, and laws of `TERMS` to compare; None
            compares the laws of friction of a swing.
        known: Numbers that are not identified, as from a bench: of all joints, or of one as `elbow.kp_n_m_per_rad`.
        held_out: Logs that are only predicted, with the identified numbers.
        load_error: Standard uncertainty of the loads, over their masses and inertias. Torques are known in proportion
            to them, so that each interval of one is wider by as much.
        part_s: Longest part of a log in stage 2 [s]; None is 20 s for servos and the whole log for others.
        settings: Numerical settings of the engine.
        stack: Training stack of the lines to paste, a table of snippets.toml; None is the engine.
        progress: Called with what is being done.

    Raises:
        ParameterError: The logs do not fit the scene or each other, or a name is unknown.
        UnsupportedSceneError: The engine does not build such a joint.
        DivergedError: The engine diverges with the best settings, or close to them.
    """
    servo = logs[0].command_rad is not None
    known = known or {}
    logs = [log.moving() for log in logs]
    of_all = [one for one in known if "." not in one]
    laws_names = {
        law: [*(one for one in terms if one not in of_all), *of_all]
        for law, terms in asked_laws(engine, servo, names).items()
    }
    first = next(iter(laws_names.values()), names)
    names = [*(one for one in first or SERVO_NAMES if one not in of_all), *of_all]
    everything = {one for terms in laws_names.values() for one in terms}
    _check_request(scene, [*logs, *held_out], [*names, *everything])
    _check_known(known, logs[0], names)
    if BACKLASH in everything | {*names} and not known.get(DYNAMICS[2]):
        raise ParameterError(
            "backlash needs the inertia of the rotor, which a log hardly tells: state it, --known armature_kg_m2=VALUE"
        )
    machine = machine_of(engine, scene, logs[0], names, settings or {})
    fitter = Fitter(machine=machine, known=known, part_s=part_s)
    laws: tuple[Law, ...] = ()
    searcher = fitter
    if laws_names:
        # Where laws are compared, the first fit only starts the others.
        for searcher in (fitter.coarser(), fitter):
            fit = searcher.fit(logs, names, tolerance=NEAR, progress=progress)
            if not fit.problem.diverges(fit.unknowns):
                break
        laws, alone = compare_laws(searcher, logs, laws_names, fit, progress)
        names = laws_names[laws[0].name]
        fit = fitter.fit(logs, names, first=fit, progress=progress)
    else:
        fit = fitter.fit(logs, names, progress=progress)
        alone = [fit] * len(logs)
    if len(logs) == 1:
        # Halves of one log are no files.
        alone = []
    elif searcher is not fitter or not laws_names:
        progress("each log alone")
        alone = [
            fitter.fit([log], names, first=one)
            for log, one in zip(logs, alone, strict=True)
        ]
    long, unknowns = fit.problem, fit.unknowns
    long.check_margin(unknowns)
    count = long.joints
    fitted_settings = settings_of(long, unknowns, fit.covariance)
    found = with_load_error(
        between_files(fitted_settings, alone, load_error), load_error
    )
    joint_words = joint_names(logs[0], count)
    if isinstance(machine, ModelJoints):
        joint_words = machine.joints
    left_out, unknowns = _without_open(long, found, unknowns, progress)
    values = [
        {name: value + 0.0 for name, value in {**stated, **given}.items()}
        for stated, given in zip(
            machine.stated, long.unknowns(unknowns)[0], strict=True
        )
    ]
    marked = [
        {one.name: one.unknown for one in found if one.joint == joint and one.unknown}
        for joint in range(count)
    ]
    printed = partial(
        snippet_lines,
        names=joint_words,
        joints=values,
        left_out=left_out,
        marked=marked,
        timestep_s=machine.timestep_s,
    )
    lines = printed(engine.name)
    is_replayed = isinstance(machine, ModelJoints) and servo
    if isinstance(machine, ModelJoints) and is_replayed:
        error_rad = machine.replayed(lines, values, logs)
        held_out_rad = machine.replayed(lines, values, held_out)
    else:
        error_rad = errors_of_logs(long, unknowns)
        predicted = replace(fit, unknowns=unknowns).predicted
        held_out_rad = {
            log.name: np.sqrt((predicted(log) ** 2).mean(axis=0)) for log in held_out
        }
    return Identified(
        engine=engine.name,
        settings=tuple(
            replace(
                one,
                joint_name=joint_words[one.joint],
                pasted=None
                if one.name in left_out[one.joint]
                else values[one.joint][one.name],
            )
            for one in found
        ),
        joints=values,
        names=joint_words,
        lines=lines,
        stack_lines=printed(stack) if stack else "",
        error_rad=error_rad,
        held_out_rad=held_out_rad,
        motion_rad={
            log.name: log.position_rad.std(axis=0) for log in (*logs, *held_out)
        },
        plain_rad=baselines(logs, held_out),
        noise_rad=sensor_noise_of(long, unknowns),
        patterns=patterns_of(long, unknowns),
        trades=trades_of(long, fit.covariance, joint_words),
        step_rad=errors_of_step(long, unknowns),
        laws=laws,
        files=len(logs),
        is_replayed=is_replayed,
        simulations=fit.simulations,
    )


def _check_request(
    scene: Scene | MjSpec, logs: Sequence[Log], names: Sequence[str]
) -> None:
    """Raise `ParameterError` unless all logs are of the joints of the scene, and all names of their numbers."""
    servo = logs[0].command_rad is not None
    for log in logs:
        if isinstance(scene, Scene):
            check_joints(scene, log)
        if log.joints != logs[0].joints:
            raise ParameterError(
                f"{log.name} has the joints {', '.join(log.joints) or 'without names'}, and {logs[0].name} "
                f"{', '.join(logs[0].joints) or 'without names'}: all logs need the same, in the same order"
            )
        if (log.command_rad is not None) != servo:
            raise ParameterError(
                f"{log.name}: all logs must state commands of servos, or none"
            )
    for name in names:
        known = [*DYNAMICS, BACKLASH, "delay_s"]
        if servo:
            known += [*SERVO[:2], LIMIT, OFFSET]
        if name not in (*known, *SERVO_FRICTION):
            laws = ", ".join((*TERMS, PLAY_LAW))
            raise ParameterError(
                f"{name}: no number of such a joint; known: {', '.join(known)}, and the laws {laws}"
            )


def _check_known(known: Mapping[str, float], log: Log, names: Sequence[str]) -> None:
    """Raise `ParameterError` unless known numbers of single joints are of joints of the log, and of fitted names."""
    joints = joint_names(log, log.position_rad.shape[1])
    for key in known:
        joint, _, name = key.rpartition(".")
        if joint and joint not in joints:
            raise ParameterError(
                f"{key}: the log has no joint {joint}; it has {', '.join(joints)}"
            )
        if name not in names:
            raise ParameterError(
                f"{key}: {name} of the other joints is not fitted; state it of all joints, or name it in --fit"
            )


def machine_of(
    engine: Backend,
    scene: Scene | MjSpec,
    log: Log,
    names: Sequence[str],
    settings: Mapping[str, Any],
) -> Machine:
    """Return the joints of a scene or a model on an engine."""
    if not isinstance(scene, Scene):
        if engine.name != "mujoco":
            raise ParameterError(
                f"an MJCF model is simulated by mujoco: leave --backend {engine.name} out, or name a USD layer"
            )
        return joints_of_model(scene, log, settings)
    check_joints(scene, log)
    hinges = len(scene.hinges)
    known = SceneJoints(engine, scene, settings)
    guesses = guessed(known, names, {})
    built = with_terms(scene, guesses, log, np.zeros(hinges))
    support = scene_support(engine, built)
    if not support:
        raise UnsupportedSceneError(
            f"backend {engine.name!r}: {'; '.join(support.missing)}"
        )
    if engine.name != "mujoco":
        return known
    given = with_drive_interval(settings, DRIVE_INTERVAL_S)
    # Plain MuJoCo gets laws of friction by its own dry friction, and a play by a hinge that is added later.
    rigid = [{**one, BACKLASH: 0.0} for one in guesses]
    built = with_terms(scene, rigid, log, np.zeros(hinges))
    simulation = engine.build(without_laws(built, quadratic=False), given or None)
    try:
        spec = simulation.spec  # type: ignore[attr-defined]
        return joints_of_scene(scene, spec, log, known.stated, settings)
    finally:
        simulation.close()


def _without_open(
    problem: Problem,
    found: Sequence[Setting],
    unknowns: FloatArray,
    progress: Callable[[str], None],
) -> tuple[list[dict[str, str]], FloatArray]:
    """Set what is not determined to what the scene states, and fit the rest, where that follows the logs as well.

    Two numbers that go with each other may both be needed: those stay, and are marked. But an armature that is not
    determined is never fitted, as a policy meets it in contact.

    Returns:
        Names of the numbers of each joint that are as stated, with the reason, and the unknowns.
    """
    left_out: list[dict[str, str]] = [{} for _ in range(problem.joints)]
    tried: set[tuple[int, str]] = set()
    remaining, best = found, problem.squares(unknowns)
    while candidates := _to_leave_out(problem, remaining, tried):
        before = problem.fixed.copy()
        for one in candidates:
            tried.add((one.joint, one.name))
            place = problem.names.index(one.name), one.joint
            problem.fixed[place] = problem.machine.stated[one.joint][one.name]
        progress(f"without {', '.join(sorted({one.name for one in candidates}))}")
        other = problem.solved(unknowns, SERVO_CLOSE, REFIT_STEPS)
        squares = problem.squares(other)
        worse = [
            one
            for one in candidates
            if one.name != DYNAMICS[2]
            and squares[one.joint] > AS_WELL**2 * best[one.joint]
        ]
        if worse:
            # The others of this round are tried again in the next, with what worse follows the logs as it was.
            problem.fixed[:] = before
            tried -= {(one.joint, one.name) for one in candidates if one not in worse}
            continue
        for one in candidates:
            left_out[one.joint][one.name] = one.unknown
            if one.name == DYNAMICS[2]:
                best[one.joint] = squares[one.joint]
        unknowns = other
        remaining = settings_of(problem, other, problem.covariance(other))
    for one in remaining:
        if one.unknown == ZERO and one.name == SERVO[0]:
            left_out[one.joint][one.name] = one.unknown
    return left_out, unknowns


def _to_leave_out(
    problem: Problem, settings: Sequence[Setting], tried: Collection[tuple[int, str]]
) -> list[Setting]:
    """Return of each joint the number that is determined least, if any is not determined.

    Where only ratios are told, the armature goes first: the inertia of the load then gives the scale. A servo is none
    without kp, which `_without_open` judges last. A law of friction predicts as a whole, and stays so.
    """

    def openness(one: Setting) -> tuple[bool, float]:
        is_armature = one.unknown == SCALE and one.name == DYNAMICS[2]
        return is_armature, (one.high - one.low) / max(abs(one.value), 1e-300)

    def may_be_stated(one: Setting) -> bool:
        if one.name == DYNAMICS[2]:
            return True
        away = abs(one.value - problem.machine.stated[one.joint][one.name])
        return SERVO[0] in problem.names and away < PLAUSIBLE * (one.high - one.value)

    found = []
    for joint in sorted({one.joint for one in settings}):
        candidates = [
            one
            for one in settings
            if one.joint == joint
            and one.unknown
            and one.name not in (SERVO[0], *SERVO_FRICTION)
            and (joint, one.name) not in tried
            and may_be_stated(one)
        ]
        if candidates:
            found.append(max(candidates, key=openness))
    return found
