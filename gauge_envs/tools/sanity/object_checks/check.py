"""Define a check of measured objects: its scenario, its number, and the real value, from the facts of trials."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

from gauge_envs.backends import Backend, Simulation
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.settings import with_drive_interval
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import find_variant
from gauge_envs.files import data_folder
from gauge_envs.fixtures.recording import Recording, UnsupportedError, record
from gauge_envs.scene import Pose, RigidBody, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.text import toml_document
from gauge_envs.tools.sanity.verdict import Need, Reality, Settings

MIN_SAMPLES = 5
"""A scene with fewer samples shows no motion."""


@dataclass(frozen=True)
class Scenario:
    """A scene of the suite and the time for which it is simulated.

    Attributes:
        name: Unique name, by which rollouts are cached.
        variant: Variant of the suite, such as `SlopeSlider-1-wood`.
        seconds: Simulated time [s].
        given: Scene in place of the variant's scene; None for the latter.
        interval_s: Longest time between samples, unless a step is longer [s].
        released: Bodies that rest on a fixed one at the start. They start apart by the margin of a configuration, at
            which they settle; from a touching pose they would be thrown up.
    """

    name: str
    variant: str
    seconds: float
    given: Scene | None = None
    interval_s: float = 0.002
    released: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Gymnasium id of the variant."""
        return find_variant(self.variant).id

    @cached_property
    def scene(self) -> Scene:
        """The scene, with the prescribed motions of the task file."""
        return self.given or load_experiment(self.variant).scene

    def scene_with(self, settings: Settings) -> Scene:
        """Return the scene with released bodies at the height at which the margin of settings lets them settle."""
        apart_m = settings.get("contact_margin_m") or 0.0
        if apart_m <= 0.0:
            return self.scene

        def lifted(body: RigidBody) -> Pose:
            if body.name not in self.released:
                return body.pose
            up_m = body.pose.rotation.apply([0.0, 0.0, apart_m])
            return replace(body.pose, position_m=vector(body.pose.position_m + up_m))

        return posed(self.scene, lifted)


def posed(scene: Scene, pose_of: Callable[[RigidBody], Pose]) -> Scene:
    """Return a scene whose rigid bodies have other poses."""
    bodies = [replace(body, pose=pose_of(body)) for body in scene.bodies]
    return replace(scene, bodies=tuple(bodies))


def run_scenario(backend: Backend, scenario: Scenario, settings: Settings) -> Recording:
    """Build a scenario's scene, run it and record it.

    It is driven and sampled every few steps, as many as fit in the scenario's interval, or every step. Settings without
    a step leave the step to the backend. The interval is then the one of its preset, 1/180 s by default.

    Args:
        backend: The backend.
        scenario: The scenario.
        settings: Settings of the backend; the backend's default for the scene completes them.

    Raises:
        UnsupportedError: The scene is unsupported, or the step is too long for it.
        DivergedError: The engine fails, or a body leaves what the scene allows.
    """
    if settings.get("timestep_s") is None:
        # A given step gives every rollout of the scenario the same sampling rule.
        with closing(_built(backend, scenario, settings)) as simulation:
            effective = simulation.settings
        if "timestep_s" in effective:
            settings = {**settings, "timestep_s": effective["timestep_s"]}
    with closing(_built(backend, scenario, settings)) as simulation:
        interval_s = simulation.settings.get("drive_interval_s", SAMPLE_INTERVAL_S)
        seconds = scenario.seconds
        if interval_s > seconds / MIN_SAMPLES:
            reason = (
                f"a step of {interval_s:g} s is too long for a scene of {seconds:g} s"
            )
            raise UnsupportedError((reason,))
        simulation.reset(None, 0)
        return record(
            simulation,
            scenario.scene_with(settings),
            seconds,
            interval_s=float(interval_s),
            speed_limit_m_per_s=scenario.scene.speed_limit_m_per_s,
            nodes_of=(),
        )


def _built(backend: Backend, scenario: Scenario, settings: Settings) -> Simulation:
    support = scene_support(backend, scenario.scene)
    if not support:
        raise UnsupportedError(support.missing)
    given = with_drive_interval(settings, scenario.interval_s)
    try:
        return backend.build(scenario.scene_with(settings), given)
    # Engines reject combinations of settings by exceptions of any kind; another scene may accept them.
    except Exception as error:
        reason = str(error)
        if not isinstance(error, ParameterError):
            reason = f"{type(error).__name__}: {error}"
        raise UnsupportedError((reason,)) from error


# --- checks ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ObjectCheck:
    """Behaviour of real objects, measured by one number.

    Attributes:
        title: Title of a few words.
        scenario: Scenario that shows the behaviour.
        unit: Unit of the number; `1` for a pure number.
        reality: Value and scatter for real objects.
        value: Function that measures the number in a rollout of the scenario.
        needs: What a target must have in addition to gravity, contacts and friction.
        id: Stable name, which the list of checks gives.
    """

    title: str
    scenario: Scenario
    unit: str
    reality: Reality
    value: Callable[[Recording], float]
    needs: tuple[Need, ...] = ()
    id: str = ""


@cache
def facts(name: str) -> dict[str, Any]:
    """Return the table of `scoring/facts/<name>.toml`."""
    file = data_folder("scoring") / "facts" / f"{name}.toml"
    return toml_document(file.read_bytes())


def rigid_law(source: str, millimetres: float, of: str) -> Reality:
    """Return the law that something does not move, with a tolerance that the eye sees.

    Args:
        source: The law.
        millimetres: Tolerance [mm].
        of: Length that shows how small the tolerance is.
    """
    rationale = f"the eye sees {millimetres:g} mm on {of}"
    return Reality(0.0, millimetres, source, rationale)
