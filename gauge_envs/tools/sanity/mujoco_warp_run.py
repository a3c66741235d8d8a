"""Run scenes on mujoco_warp, with the model that the MuJoCo backend compiles: the same options, in single precision.

The rows of a sanity check run MuJoCo's C engine. Policies are trained on its version for GPUs. A flagged row is run
again here, on the CPU, to see whether it holds there. The first run of a kernel compiles it, up to a minute in all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np

from gauge_envs.backends.base import Feature, Support
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.model import build_model
from gauge_envs.backends.mujoco.settings import SettingsMuJoCo, settings_for
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.errors import BackendError, MissingExtraError
from gauge_envs.scene import Scene
from gauge_envs.tools.sanity.measure import Measurements
from gauge_envs.tools.sanity.model import CapacityLimits, PhenomenonResult, Report, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.phenomena import phenomenon
from gauge_envs.tools.sanity.robot.contact_capacity import most_needed_data
from gauge_envs.tools.sanity.subject import subject_of

MOST_ROWS, MOST_CONTACTS = 1024, 256
"""Memory of a target's own model for constraint rows and for contacts, where it is not limited."""

FEWEST_CONTACTS, CONTACTS_OF_BODY = 64, 16
"""Memory of a scene for contacts: a number, and more for each body. A brick of a wall has 7."""

ROWS_OF_CONTACT = 6
"""Memory of a scene for constraint rows, for each contact; a contact with the pyramidal cone has 4."""

TOO_LARGE = "the scene needs more memory for contacts than is reserved"
"""Start of the reason why a scene is not run to its end."""

EFFECT_S = 0.5
"""Time for which a model moves with too little memory and with enough [s]."""


class BackendMuJoCoWarp(BackendMuJoCo):
    """mujoco_warp on the CPU, for rigid scenes; settings are those of the MuJoCo backend."""

    name = "mujoco_warp"
    features = frozenset({Feature.STATED_INERTIA})

    def __init__(self) -> None:
        _started()

    def versions(self) -> dict[str, str]:
        """Return the versions of the engine and of Warp."""
        return {package: version(package) for package in ("mujoco-warp", "warp-lang", "mujoco")}

    def supports(self, scene: Scene) -> Support:
        """Return the unsupported features: deformable bodies, and what MuJoCo does not support."""
        own = ("deformable bodies run on MuJoCo's C engine alone",) if scene.deformables else ()
        return Support((*own, *super().supports(scene).missing))

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> SimulationMuJoCoWarp:
        """Build a scene; settings are the fields of `SettingsMuJoCo`."""
        chosen = settings_for(scene, settings)
        return SimulationMuJoCoWarp(scene, chosen.model_dump(mode="json"), *build_model(scene, chosen))


class SimulationMuJoCoWarp(SimulationMuJoCo):
    """A scene on mujoco_warp. MuJoCo's data hold the state between the steps, so that it is driven and read there."""

    def __init__(self, scene: Scene, settings: Mapping[str, Any], *built: Any) -> None:
        super().__init__(scene, settings, *built)
        self._most_contacts = FEWEST_CONTACTS + CONTACTS_OF_BODY * len(scene.bodies)
        self._put()

    def reset(self, seed: int) -> None:
        """Return to the scene's start; the seed has no effect."""
        super().reset(seed)
        self._put()

    def _put(self) -> None:
        most = self._most_contacts
        self._on_warp, self._state = _put(self.model, self.data, njmax=ROWS_OF_CONTACT * most, naconmax=most)

    def _step(self, count: int) -> None:
        state, (warp, device) = self._state, _started()
        with device:
            for name in ("qpos", "qvel", "xfrc_applied"):
                values = getattr(self.data, name)
                getattr(state, name).assign(values.reshape(1, *values.shape))
            for _ in range(count):
                warp.step(self._on_warp, state)
        self.data.qpos[:], self.data.qvel[:] = state.qpos.numpy()[0], state.qvel.numpy()[0]
        self.data.time += count * self._timestep_s
        # mujoco_warp does not count contacts beyond its memory, so full memory is too small.
        if state.nefc.numpy()[0] > state.njmax or state.nacon.numpy()[0] >= self._most_contacts:
            raise BackendError(f"{TOO_LARGE}: {self._most_contacts} contacts")


def with_mujoco_warp(report: Report, *, model: mujoco.MjModel | None = None) -> Report:
    """Return a report whose flagged rows state whether they hold on mujoco_warp.

    Args:
        report: A report on MuJoCo's C engine.
        model: The target's own model, for the row on the memory for contacts; None when there is none.
    """
    backend = BackendMuJoCoWarp()
    engine = f"mujoco_warp {backend.versions()['mujoco-warp']}"
    configuration = report.configuration
    if configuration.backend != "mujoco":
        note = f"{engine} runs models of MuJoCo; the target runs on {configuration.backend}"
        return replace(report, notes=(*report.notes, note))
    measurements = Measurements(backend)
    cure = {} if report.cure is None else report.cure.changes
    changes = {name: value for name, value in cure.items() if name in SettingsMuJoCo.model_fields}
    rows, held = list(report.rows), []
    for place, row in enumerate(rows):
        if row.is_flag and row.experiment:
            text, holds = _again(measurements, configuration, row, engine, changes)
            rows[place] = replace(row, remark=f"{row.remark}; {text}" if row.remark else text)
            held.append(holds)
    limits = None if configuration.capacity is None else configuration.capacity.limits
    notes = [f"{sum(held)} of {len(held)} flags hold on {engine}"] if held else []
    if model is not None and limits is not None:
        notes.append(f"on {engine}, {overflow_effect(model, limits)}")
    return replace(report, rows=tuple(rows), notes=(*report.notes, *notes))


def overflow_effect(model: mujoco.MjModel, limits: CapacityLimits) -> str:
    """Return what the limits of the memory for contacts do to a model on mujoco_warp, in words.

    The model starts in the state in which MuJoCo's C engine counts most constraint rows. mujoco_warp counts its own
    rows and contacts there. If they do not fit, a world moves with its share of the memory and with enough of it.

    Args:
        model: The target's own model.
        limits: Its limits.
    """
    rows = MOST_ROWS if limits.njmax is None else limits.njmax
    contacts = MOST_CONTACTS if limits.naconmax is None or not limits.worlds else limits.naconmax // limits.worlds
    start = most_needed_data(model)
    _, needed_rows, needed_contacts = _moved(model, start, MOST_ROWS, MOST_CONTACTS, 0.0)
    need = f"the model needs {needed_rows} constraint rows and {needed_contacts} contacts"
    if needed_rows <= rows and needed_contacts <= contacts:
        return f"{need} at most, and has place for them"
    lost = _moved(model, start, rows, contacts, EFFECT_S)[0]
    enough = _moved(model, start, MOST_ROWS, MOST_CONTACTS, EFFECT_S)[0]
    if not np.isfinite(lost.qpos).all():
        outcome = "the state is no longer finite"
    else:
        difference = np.abs(lost.qpos - enough.qpos)
        joint = int(np.searchsorted(model.jnt_qposadr, int(difference.argmax()), side="right")) - 1
        name = model.joint(joint).name or f"number {joint}"
        outcome = f"joint {name} is {difference.max():.2g} (m or rad) elsewhere than with enough memory"
    return f"{need}, and has place for {rows} and {contacts}: after {EFFECT_S:g} s {outcome}"


def _moved(
    model: mujoco.MjModel, start: mujoco.MjData, njmax: int, naconmax: int, seconds: float
) -> tuple[mujoco.MjData, int, int]:
    """Return the data after some time on mujoco_warp, and the constraint rows and contacts that the start needs."""
    end, blank = mujoco.MjData(model), mujoco.MjData(model)
    for name in ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat"):
        getattr(blank, name)[:] = getattr(start, name)
    warp, device = _started()
    on_warp, state = _put(model, blank, njmax=njmax, naconmax=naconmax)
    with device:
        warp.forward(on_warp, state)
        rows, contacts = int(state.nefc.numpy()[0]), int(state.nacon.numpy()[0])
        for _ in range(round(seconds / model.opt.timestep)):
            warp.step(on_warp, state)
    end.qpos[:], end.qvel[:] = state.qpos.numpy()[0], state.qvel.numpy()[0]
    return end, rows, contacts


def _put(model: mujoco.MjModel, data: mujoco.MjData, *, njmax: int, naconmax: int) -> tuple[Any, Any]:
    """Return a model and its data on mujoco_warp, with memory for so many constraint rows and contacts."""
    warp, device = _started()
    with device:
        on_warp = warp.put_model(model)
        # It runs into its limit of iterations on purpose, with settings that allow one.
        on_warp.opt.warn_overflow = 0
        return on_warp, warp.put_data(model, data, naconmax=naconmax, njmax=njmax)


def _again(
    measurements: Measurements,
    configuration: TrainingConfiguration,
    row: PhenomenonResult,
    engine: str,
    changes: Mapping[str, Any],
) -> tuple[str, bool]:
    """Return the outcome of a flagged row on mujoco_warp, also with changes, and whether it is flagged there too."""
    subject = subject_of(measurements, configuration, phenomenon(row.phenomenon))
    settings = subject.sets.get(row.geoms) or next(iter(subject.sets.values()))
    measured = measurements.measure(subject.phenomenon, settings)
    if measured.verdict is Verdict.DECLINED or TOO_LARGE in measured.remark:
        return f"not run on {engine}: {measured.remark}", False
    unit = "" if row.unit == "1" else f" {row.unit}"
    holds = measured.verdict in (Verdict.VISIBLE, Verdict.WRONG)
    value = measured.remark
    if measured.value is not None:
        value = f"{measured.value:.3g} of {row.reality.value:.3g}{unit}"
    text = f"{'holds' if holds else 'does not hold'} on {engine}: {value}"
    if changes:
        cured = measurements.measure(subject.phenomenon, {**settings, **changes})
        after = cured.remark if cured.value is None else f"{cured.value:.3g}"
        text += f", and {after} there with the change on top"
    return text, holds


def _started() -> tuple[Any, Any]:
    """Return mujoco_warp and its device, without its messages."""
    try:
        import mujoco_warp
        import warp
    except ImportError as error:
        raise MissingExtraError("running on mujoco_warp", "newton", error) from None
    warp.config.log_level = warp.LOG_WARNING
    return mujoco_warp, warp.ScopedDevice("cpu")
