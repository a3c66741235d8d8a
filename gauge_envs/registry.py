"""Look up installed parts: engines, Gymnasium ids of tools, readers of scene files, and lazily imported names.

The core imports tools of `gauge_envs.tools` only through the functions here. Engines are entry points of the group
`gauge_envs.backends`, which other packages can extend.
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
"""Prefix of the modules of this package."""
PACKAGE = Path(__file__).parent
SCENE_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of scene files, which every engine can use."""
MODEL_SUFFIX = ".xml"
"""Suffix of model files, which only their engine reads."""


@cache
def _scanned(
    scan: Callable[..., Any], group: str, path: tuple[str, ...]
) -> tuple[EntryPoint, ...]:
    return tuple(scan(group=group))


def installed_points(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group; a scan takes 10 to 25 ms, so each search path is scanned once."""
    return _scanned(entry_points, group, tuple(sys.path))


def engine_points() -> tuple[EntryPoint, ...]:
    """Return the entry points of engines, without bundled engines whose folder is missing."""
    return tuple(
        point
        for point in installed_points(ENGINES_GROUP)
        if not point.value.startswith(BUNDLED)
        or (PACKAGE / "backends" / point.name).is_dir()
    )


def is_installed(module: str) -> bool:
    """Return whether a top-level module is installed.

    Python also finds folders without `__init__.py`, such as a checkout of an engine next to a script. These have no
    origin.
    """
    spec = find_spec(module)
    return spec is not None and spec.origin is not None


# --- tools that the core uses ----------------------------------------------------------------------------------------


def id_modules() -> tuple[Any, ...]:
    """Return the modules of further Gymnasium ids; each has `register`, `names`, `summary` and `document`.

    Other packages register their ids when Gymnasium imports them, as `my_package:Id`.
    """
    if not (PACKAGE / "tools" / "control").is_dir():
        return ()
    return (import_module("gauge_envs.tools.control.ids"),)


def scene_files(suffix: str) -> Any:
    """Return the module that reads and writes scene files of a suffix, as `.usda`.

    Raises:
        RegistryError: No module reads such files.
        MissingExtraError: The extra `usd` is not installed.
    """
    if suffix not in SCENE_SUFFIXES:
        raise RegistryError(
            f"cannot read scene files {suffix!r}; known: {', '.join(SCENE_SUFFIXES)}"
        )
    with needs_extra(f"a file {suffix}", "usd"):
        return import_module("gauge_envs.tools.usd")


def model_files() -> Any:
    """Return the module that reads MJCF files, with `read_model` and `BackendMJCF`."""
    return import_module("gauge_envs.tools.mjcf.reader")


# --- lazily imported names -------------------------------------------------------------------------------------------


def lazy_names(
    package: str, modules: Mapping[str, Sequence[str]], *, extra: str = ""
) -> tuple[Callable[[str], Any], list[str]]:
    """Return `__getattr__` and `__all__` of a package that imports its names at first use (PEP 562).

    Args:
        package: Name of the package.
        modules: Names by module; a module may be relative to the package, as `.comparison`.
        extra: Extra that the names need; empty for none.
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
