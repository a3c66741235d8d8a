"""Registry of backends, which installed packages provide through an entry-point group; see `gauge_envs.registry`."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path

from gauge_envs.backends.base import Backend, scene_support
from gauge_envs.backends.features import Support
from gauge_envs.errors import BackendError, GaugeError, ParameterError, UnknownNameError
from gauge_envs.registry import BUNDLED, engine_points
from gauge_envs.scene import Scene

MODEL_ENGINE = "mujoco"
"""The backend that builds model files."""

ISAAC_SIM = "Isaac Sim is not a backend but runs layers of this package, see docs/engines/isaac_sim.md"
"""Hint for a name of Isaac Sim."""


def backend_names() -> tuple[str, ...]:
    """Return the sorted names of all installed backends, without importing any."""
    return tuple(sorted({point.name for point in engine_points()}))


def _entry_point(name: str) -> EntryPoint | None:
    """Return the entry point of a backend, or None if no installed package provides it."""
    return next((point for point in engine_points() if point.name == name), None)


@cache
def backend(name: str) -> Backend:
    """Return the backend of a name. The first call imports it.

    Raises:
        UnknownNameError: No installed package provides it.
        MissingExtraError: Its engine is not installed.
        BackendError: Its package cannot be imported for another reason, or its class is not a backend of that name.
    """
    point = _entry_point(name)
    if point is None:
        hint = ISAAC_SIM if "isaac" in name.lower() else ""
        raise UnknownNameError("backend", name, backend_names(), hint)
    place = f"backend {name!r} ({point.value})"
    with _as_backend_error(place):
        engine = point.load()()
    if not isinstance(engine, Backend):
        raise BackendError(
            f"{place}: the entry point gives a {type(engine).__name__}, expected a Backend"
        )
    if engine.name != name:
        raise BackendError(
            f"{place}: the class has the name {engine.name!r}. "
            "Give the key of the entry point and the attribute `name` of the class the same text."
        )
    return engine


def is_bundled(name: str) -> bool:
    """Return whether the backend of a name is part of this package."""
    point = _entry_point(name)
    return point is not None and point.value.startswith(BUNDLED)


def backend_class(name: str) -> type[Backend]:
    """Return the class of a backend, or `Backend` if no installed package provides the name as a class.

    The attributes of the class are the same whether or not its engine is installed.
    """
    point = _entry_point(name)
    if point is not None:
        with suppress(GaugeError), _as_backend_error(name):
            loaded = point.load()
            if isinstance(loaded, type) and issubclass(loaded, Backend):
                return loaded
    return Backend


def shares_worlds(name: str) -> bool:
    """Return whether a backend advances the worlds of `build_worlds` together, in one simulation."""
    kind = backend_class(name)
    is_batched = kind.build_worlds is not Backend.build_worlds
    return kind.worlds_share_simulation and is_batched


def uninstalled_backend(name: str) -> Backend:
    """Return a backend of this package that answers `supports` and `resolved_settings` without its engine.

    It cannot build; the answers are the same whether or not the engine is installed.
    """
    return object.__new__(backend_class(name))


@contextmanager
def _as_backend_error(place: str) -> Iterator[None]:
    """Raise a `BackendError` for anything that an engine raises, so that other backends stay usable.

    Errors of this package and Ctrl-C pass.
    """
    try:
        yield
    except (GaugeError, KeyboardInterrupt):
        raise
    except BaseException as error:  # Also SystemExit.
        # After Ctrl-C in an import, releasing the module's lock can raise another error.
        if isinstance(error.__context__, KeyboardInterrupt):
            raise error.__context__ from None
        raise BackendError(
            f"{place}: {type(error).__name__}: {error}".removesuffix(": ")
        ) from error


@contextmanager
def engine_call(name: str, method: str) -> Iterator[None]:
    """Raise a `BackendError` for anything that a method of an engine raises, SystemExit included.

    Args:
        name: Name of the backend.
        method: The method, as `supports`.

    Raises:
        BackendError: The method raised an error that is neither of this package nor Ctrl-C.
    """
    with _as_backend_error(f"backend {name!r}: {method} raised an error"):
        yield


def support_of(name: str, scene: Scene, model_file: Path | None = None) -> Support:
    """Return whether a backend can build a scene.

    Args:
        name: Name of the backend.
        scene: The scene.
        model_file: File that replaces the scene, or None.

    Raises:
        GaugeError: An error of `backend`, or a `BackendError` of `supports`.
    """
    if model_file is not None and name != MODEL_ENGINE:
        return Support((f"{model_file.name} is a model of another engine",))
    engine = backend_for(name, model_file)
    with engine_call(name, "supports"):
        return scene_support(engine, scene)


def versions_of(name: str) -> dict[str, str]:
    """Return the versions of a backend's packages.

    Raises:
        GaugeError: An error of `backend`, or a `BackendError` of `versions`.
    """
    return checked_versions(backend(name))


def checked_versions(engine: Backend) -> dict[str, str]:
    """Return the versions of an engine's packages.

    Raises:
        BackendError: `versions` raises an error, or returns anything but texts by package.
    """
    with engine_call(engine.name, "versions"):
        versions = engine.versions()
    if not isinstance(versions, Mapping) or not all(
        isinstance(part, str) for pair in versions.items() for part in pair
    ):
        raise BackendError(
            f"backend {engine.name!r}: versions returned {versions!r}, expected texts by package, as "
            f'{{"{engine.name}": "1.0"}}'
        )
    return dict(versions)


def backend_for(name: str, model_file: Path | None) -> Backend:
    """Return the backend of a name, or MuJoCo with the model of a file if one replaces the scene.

    Raises:
        UnknownNameError: No installed package provides it.
        MissingExtraError: Its engine is not installed.
        BackendError: Its package cannot be imported for another reason.
        ParameterError: The name is not a text.
    """
    if not isinstance(name, str):
        raise ParameterError(
            f"backend {name!r}: expected the name of a backend, as 'mujoco'"
        )
    engine = backend(name)
    if model_file is None:
        return engine
    from gauge_envs.backends.mujoco.mjcf.reader import BackendMJCF

    return BackendMJCF(model_file)
