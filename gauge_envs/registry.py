"""Look up what is installed: engines, Gymnasium ids of tools, readers of scene files, and names imported at first use.

The core imports no tool of `gauge_envs.tools` by name; the functions here import one when it is needed. Engines come
from entry points of the group `gauge_envs.backends`, also those of other packages.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gauge_envs.errors import RegistryError, needs_extra

ENGINES_GROUP = "gauge_envs.backends"
BUNDLED = "gauge_envs."
"""First part of the name of a module of this package."""
PACKAGE = Path(__file__).parent
SCENE_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MODEL_SUFFIX = ".xml"
"""Suffixes of scene files that every engine reads, by way of a scene."""


@cache
def _scanned(
    scan: Callable[..., Any], group: str, path: tuple[str, ...]
) -> tuple[EntryPoint, ...]:
    return tuple(scan(group=group))


def installed_points(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group. A scan takes 10 to 25 ms, so it is done once for each search path."""
    return _scanned(entry_points, group, tuple(sys.path))


def engine_points() -> tuple[EntryPoint, ...]:
    """Return the entry points of engines, without those of this package whose folder is absent."""
    return tuple(
        point
        for point in installed_points(ENGINES_GROUP)
        if not point.value.startswith(BUNDLED)
        or (PACKAGE / "backends" / point.name).is_dir()
    )


def is_installed(module: str) -> bool:
    """Say whether a top-level module is installed.

    Python also finds a folder without `__init__.py`, as a checkout of an engine beside the user's script; such a folder
    has no origin.
    """
    spec = find_spec(module)
    return spec is not None and spec.origin is not None


# --- tools that the core uses ----------------------------------------------------------------------------------------


def id_modules() -> tuple[Any, ...]:
    """Return the modules of Gymnasium ids other than the experiments, with `register`, `names`, `summary`, `document`.

    Another package registers its ids through Gymnasium's entry points, `gymnasium.envs`.
    """
    if not (PACKAGE / "tools" / "control").is_dir():
        return ()
    return (import_module("gauge_envs.tools.control.ids"),)


def scene_files(suffix: str) -> Any:
    """Return the module that reads and writes scene files of a suffix, as `.usda`.

    Raises:
        RegistryError: Nothing reads such files.
        MissingExtraError: The extra `usd` is not installed.
    """
    if suffix not in SCENE_SUFFIXES:
        raise RegistryError(
            f"cannot read scene files {suffix!r}; known: {', '.join(SCENE_SUFFIXES)}"
        )
    with needs_extra(f"a file {suffix}", "usd"):
        return import_module("gauge_envs.tools.usd.files")


def model_files() -> Any:
    """Return the module that reads MJCF files, with `read_model` and `BackendMJCF`."""
    return import_module("gauge_envs.tools.mjcf.reader")


# --- names imported at first use -------------------------------------------------------------------------------------


def lazy_names(
    package: str, modules: Mapping[str, Sequence[str]], *, extra: str = ""
) -> tuple[Callable[[str], Any], list[str]]:
    """Return `__getattr__` and `__all__` of a package whose names are imported at first use (PEP 562).

    Args:
        package: Name of the package, which is being imported.
        modules: Names by their module, which may be relative to the package, as `.comparison`.
        extra: Extra of this package without which the names cannot be imported.
    """
    origins = {name: module for module, names in modules.items() for name in names}

    def lookup(name: str) -> Any:
        if name not in origins:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        with needs_extra(package, extra) if extra else nullcontext():
            value = getattr(import_module(origins[name], package), name)
        setattr(sys.modules[package], name, value)
        return value

    return lookup, sorted(origins)
