"""The interface between an environment and a physics engine.

A backend is one class with three methods. It receives a `Scene` and never the name of an experiment:

    class BackendMine(Backend):
        name = "mine"

        def supports(self, scene): ...
        def build(self, scene, settings): ...
        def versions(self): ...

`build` returns a `Simulation` of one world at the scene's nominal start. `build_worlds` returns a simulation of N
worlds; by default it loops over N simulations. Every 1/180 s, the environment drives each kinematic body and advances
the simulation. An entry point of the group `gauge_envs.backends` makes a backend available by name;
docs/adding_an_engine.md gives a complete example.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Literal

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.backends.features import Feature, Support, needed_features
from gauge_envs.backends.simulation import LoopedSimulation, Simulation
from gauge_envs.errors import BackendError, ParameterError
from gauge_envs.scene import Scene
from gauge_envs.scene.fabrics import Fabric


@dataclass(frozen=True, kw_only=True)
class Repeatability:
    """How far runs of one scene with the same settings and seed diverge from each other.

    Attributes:
        kind: `bits`: every run has the same bits on one kind of processor. `run`: one simulation repeats its bits after
            `reset`, and two simulations of the scene differ. `statistical`: no run repeats another.
        start_error: Size e of the disturbance with which checks judge runs that do not repeat bits. A disturbed run
            moves the initial poses of free bodies by e [m, rad] and changes gravity by the share e. Each state
            [m, 1, m/s, rad/s] may differ by e plus ten times the difference between disturbed runs. The median state
            may differ by half of that.

    Raises:
        ParameterError: `start_error` is not 0 for `bits`, or is not between 0 and 1e-4 otherwise.
    """

    kind: Literal["bits", "run", "statistical"] = "bits"
    start_error: float = 0.0

    def __post_init__(self) -> None:
        """Check the error."""
        is_exact = self.start_error == 0.0
        is_small = 0.0 < self.start_error <= 1e-4
        if not (is_exact if self.kind == "bits" else is_small):
            raise ParameterError(
                f"start_error of repeatability {self.kind!r} is {self.start_error}: it must be 0 for 'bits', and above "
                "0 and at most 1e-4 otherwise"
            )


class Backend(ABC):
    """A physics engine.

    Attributes:
        name: Name that users type, as in `backend="mujoco"`.
        title: Name as the engine's authors write it, for pages; empty for `name`.
        color: Colour in figures, as `#0072b2`; empty for a grey that engines without a colour share.
        marker: Marker in figures, by matplotlib's names.
        configurations: Settings of further solvers and presets, by name, which are compared with the defaults. They
            must suit any scene; a scene that a solver cannot build is unsupported.
        corrections: Where the engine's own physics is replaced or completed, one sentence each. An option of the engine
            is not a correction. They apply to all presets except `own_defaults`.
        features: Optional features that `build` builds. A scene that needs another feature is unsupported, so that an
            engine written before a feature existed never ignores it.
        own_defaults: Presets that leave the engine as its makers deliver it.
        worlds_share_simulation: Whether an overridden `build_worlds` advances all worlds together. A sweep runs the
            repeats of such an engine in one batch. It runs the repeats of other engines one after another, so that an
            interrupted sweep loses less.
        contact_softness: Settings that make contacts soft, and the factor that makes contacts half as soft. Of a MuJoCo
            `solref` the factor applies to the time constant. It does not list the step.
        restarts_worlds: Whether the `reset` of an overridden `build_worlds` takes `worlds`. Vector environments loop
            over simulations of one world of any other engine.
    """

    name: ClassVar[str]
    title: ClassVar[str] = ""
    color: ClassVar[str] = ""
    marker: ClassVar[str] = "*"
    configurations: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({})
    corrections: ClassVar[tuple[str, ...]] = ()
    features: ClassVar[frozenset[Feature]] = frozenset()
    own_defaults: ClassVar[frozenset[str]] = frozenset({"out_of_box"})
    worlds_share_simulation: ClassVar[bool] = True
    contact_softness: ClassVar[Mapping[str, float]] = MappingProxyType({})
    restarts_worlds: ClassVar[bool] = False

    def whose_physics(self, preset: str) -> str:
        """Return whose physics a preset shows: `own defaults`, `own options`, or `corrected` by this package."""
        if preset in self.own_defaults:
            return "own defaults"
        return "corrected" if self.corrections else "own options"

    @abstractmethod
    def versions(self) -> dict[str, str]:
        """Return the versions of the engine's packages, which each result records."""

    @abstractmethod
    def supports(self, scene: Scene) -> Support:
        """Return whether `build` can build a scene, without building it."""

    @abstractmethod
    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build a scene in one world, at the scene's nominal start.

        Args:
            scene: A scene that `supports` accepts.
            settings: Numerical settings that replace those of the preset, by name; `preset` selects another preset.

        Raises:
            ParameterError: A setting does not exist or has an invalid value.
        """

    def repeatability(self, settings: Mapping[str, Any] | None = None) -> Repeatability:
        """Return how far repeated runs diverge, with settings as in `build`; kernels on a GPU may not repeat bits."""
        return Repeatability()

    def build_worlds(
        self,
        scene: Scene,
        world_count: int,
        settings: Mapping[str, Any] | None = None,
    ) -> Simulation:
        """Build a scene in N worlds. An engine with batched worlds overrides it.

        Args:
            scene: A scene that `supports` accepts.
            world_count: Number of worlds N.
            settings: As in `build`.

        Raises:
            ParameterError: A setting does not exist or has an invalid value.
        """
        if world_count == 1:
            return self.build(scene, settings)
        worlds = [self.build(scene, settings) for _ in range(world_count)]
        return LoopedSimulation(worlds)

    def resolved_settings(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Mapping[str, Any] | None:
        """Return the numerical settings that `build` would use, without building; None if it does not know.

        A sweep checks its settings with it before the first run, and finds equal settings.

        Args:
            scene: A scene that `supports` accepts.
            settings: As in `build`.

        Returns:
            A flat, JSON-ready mapping, or None.

        Raises:
            ParameterError: A setting does not exist or has an invalid value.
        """
        return None

    @staticmethod
    def fabric_constants(fabric: Fabric) -> FabricConstants | None:
        """Return a measured fabric in the engine's own constants; None where no mapping is known."""
        return None


def scene_support(engine: Backend, scene: Scene) -> Support:
    """Return whether an engine can build a scene, from `supports` and from the features that its class declares.

    Raises:
        BackendError: `supports` did not return a `Support`.
    """
    support = engine.supports(scene)
    if not isinstance(support, Support):
        raise BackendError(
            f"backend {engine.name!r}: supports returned a {type(support).__name__}, expected a Support"
        )
    # A feature has one reason: the last.
    needed = dict(needed_features(scene))
    reasons = tuple(
        reason for feature, reason in needed.items() if feature not in engine.features
    )
    return Support((*support.missing, *reasons))
