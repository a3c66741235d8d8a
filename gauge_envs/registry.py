"""Look up installed engines and versions, and import names lazily.

Engines are entry points of the group `gauge_envs.backends`, which other packages can extend.
"""

import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gauge_envs.optional import needs_extra

ENGINES_GROUP = "gauge_envs.backends"
BUNDLED = "gauge_envs."
"""Prefix of the modules of this package."""
PACKAGE = Path(__file__).parent


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


@cache
def package_versions() -> dict[str, str]:
    """Return the versions of gauge-envs, gymnasium, numpy and python; callers must not change the dictionary.

    They are read once, because reading the metadata of packages takes as long as a short episode.
    """
    packages = {name: version(name) for name in ("gauge-envs", "gymnasium", "numpy")}
    return packages | {"python": platform.python_version()}


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
