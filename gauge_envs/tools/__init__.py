"""Instruments: one folder each. Each package lists the names that others may use."""

from collections.abc import Callable
from importlib import import_module
from typing import Any


def door(package: str, *modules: str) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package whose names are imported at their first use.

    Args:
        package: Name of the package, which lists its names in `__all__`.
        modules: Its modules that define them, in the order in which they are searched.
    """

    def lookup(name: str) -> Any:
        if name in import_module(package).__all__:
            for module in modules:
                found = import_module(f"{package}.{module}")
                if hasattr(found, name):
                    return getattr(found, name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return lookup
