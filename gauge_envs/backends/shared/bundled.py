"""Common code of this package's backends: extras, versions, settings, and reasons for unsupported scenes."""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any, ClassVar

from gauge_envs.backends.base import Backend
from gauge_envs.backends.features import Support
from gauge_envs.backends.settings import SteppedSettings
from gauge_envs.backends.simulation import Simulation
from gauge_envs.errors import MissingExtraError, UnsupportedSceneError
from gauge_envs.registry import is_installed
from gauge_envs.scene import Compound, Motion, Scene


class BundledBackend(Backend):
    """A backend of this package.

    Attributes:
        modules: Modules of the engine, which the extra of the backend's name installs.
        packages: Packages whose versions each result records.
        settings_for: Function of a scene and a user's changes that returns the effective settings.
    """

    modules: ClassVar[tuple[str, ...]] = ()
    packages: ClassVar[tuple[str, ...]]
    settings_for: Callable[..., SteppedSettings]

    def __init__(self) -> None:
        for module in self.modules:
            if not is_installed(module):
                raise MissingExtraError(
                    f"backend {self.name!r}", self.name, self.failed_import(module)
                )

    def failed_import(self, module: str) -> ImportError:
        """Return the error of a module that cannot be imported; its name tells the user what to install."""
        return ModuleNotFoundError(name=module)

    def versions(self) -> dict[str, str]:
        """Return the versions of the engine's packages."""
        return {package: version(package) for package in self.packages}

    @abstractmethod
    def unsupported(self, scene: Scene, /) -> Iterable[str]:
        """Yield one sentence for each feature of a scene that this backend does not support, without the engine."""

    def supports(self, scene: Scene) -> Support:
        """Return the features of a scene that this backend does not support; see `unsupported`."""
        return Support(tuple(self.unsupported(scene)))

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build a scene in one world; settings are the fields of the engine's settings class."""
        return self.build_worlds(scene, 1, settings)

    def resolved_settings(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Mapping[str, Any]:
        """Return the settings of the scene's preset with the given changes."""
        return self.settings_for(scene, settings).model_dump(mode="json")


class SingleWorldBackend(BundledBackend):
    """A backend whose simulations have one world each."""

    @abstractmethod
    def simulation(self) -> Callable[..., Simulation]:
        """Return the class of simulations of a scene with settings; the first call imports the engine."""

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build a scene; settings are the fields of the engine's settings class."""
        chosen = self.settings_for(scene, settings)
        return self.simulation()(scene, chosen)


@contextmanager
def replaced(owner: Any, **attributes: Any) -> Iterator[None]:
    """Replace attributes of a module or class of an engine as long as the context lasts."""
    before = {name: getattr(owner, name) for name in attributes}
    for name, value in attributes.items():
        setattr(owner, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(owner, name, value)


def first_of(names: Sequence[str]) -> str:
    """Return the first name, with the number of further names."""
    return f"{names[0]!r}" + (f" (and {len(names) - 1} more)" if len(names) > 1 else "")


def unsupported_compounds(scene: Scene) -> Iterator[str]:
    """Yield the sentence of a backend that builds no compounds of solids, if a scene has one."""
    names = [body.name for body in scene.bodies if isinstance(body.shape, Compound)]
    if names:
        yield f"{names[0]!r} is a compound of solids, and this backend builds one solid or convex pieces for each body"


def unsupported_joints(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each joint of a body that does not move under forces."""
    for joint in scene.joints:
        motion = scene.body(joint.body).motion
        if motion is not Motion.DYNAMIC:
            yield f"{joint.body!r} has a joint and is {motion}: only dynamic bodies have joints"


def check_settings(
    engine: str, settings: SteppedSettings, missing: Iterable[str]
) -> None:
    """Raise an error if given settings do not support a scene.

    `Backend.supports` answers for the scene's own preset. A user may choose another one.

    Args:
        engine: Name of the engine, for messages.
        settings: The settings.
        missing: One sentence for each feature of the scene that they do not support.
    """
    reasons = "; ".join(missing)
    if reasons:
        raise UnsupportedSceneError(
            f"{engine} preset {settings.preset!r} does not support this scene: {reasons}. Choose another preset"
        )
