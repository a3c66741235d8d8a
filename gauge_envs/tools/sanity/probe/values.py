"""Turn values of any library into those of JSON, and find attributes of objects without importing their classes."""

import dataclasses
import enum
import math
from typing import Any

MOST_DEPTH = 24


class ProbeError(Exception):
    """The target cannot be read."""


def plain(value: Any, depth: int = 0) -> Any:
    """Return a value in JSON's types: NaN and infinity as texts, classes and functions as `module:name`."""
    if depth > MOST_DEPTH:
        raise ProbeError(f"its values are nested more than {MOST_DEPTH} deep")
    if isinstance(value, enum.Enum):
        return value.name
    if value is None or isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(entry, depth + 1) for entry in value]
    listed = array_values(value)
    if listed is not None:
        return plain(listed, depth + 1)
    if callable(value):
        return f"{getattr(value, '__module__', '')}:{getattr(value, '__qualname__', type(value).__qualname__)}"
    if isinstance(value, (slice, bytes)):
        return None
    return {str(name): plain(entry, depth + 1) for name, entry in members(value).items()}


def members(value: Any) -> dict[Any, Any]:
    """Return the public entries of a mapping, a dataclass, a pydantic model or any other object."""
    if hasattr(value, "items"):
        return dict(value.items())
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if hasattr(value, "model_dump"):
        return dict(value.model_dump())
    public = {name: found(value, name) for name in dir(value) if not name.startswith("_")}
    return {name: entry for name, entry in public.items() if not callable(entry)}


def array_values(value: Any) -> Any:
    """Return the numbers of an array of NumPy, JAX, Torch or Warp as lists; None for any other value."""
    if isinstance(value, type):
        return None
    for step in ("detach", "cpu", "numpy"):
        method = getattr(value, step, None)
        value = method() if callable(method) else value
    if str(getattr(value, "dtype", "")) == "float32":
        import numpy

        # The shortest decimals of single precision: 0.004 instead of 0.004000000189989805.
        value = numpy.asarray(value).astype("U").astype(float)
    return value.tolist() if callable(getattr(value, "tolist", None)) else None


def flat(value: Any) -> list[Any]:
    """Return the numbers of an array as one list; a number is a list of one, and a truth value is 0 or 1."""
    listed = value if isinstance(value, (list, int, float)) else array_values(value)
    if not isinstance(listed, list):
        return [int(listed) if isinstance(listed, bool) else listed]
    return [number for entry in listed for number in flat(entry)]


def found(value: Any, place: str) -> Any:
    """Return the attribute or entry at a place such as `sim.cfg`; None where there is none."""
    for name in [part for part in place.split(".") if part]:
        try:
            value = value[name] if isinstance(value, dict) else getattr(value, name, None)
        except Exception:  # Properties of other packages raise anything, such as an error before the first reset.
            return None
        if value is None:
            return None
    return value


def is_of(value: Any, package: str, name: str) -> bool:
    """Return whether a value's class has that name and is from that package, which need not be imported."""
    return any(one.__name__ == name and one.__module__.split(".")[0] == package for one in type(value).__mro__)


def is_number(value: Any) -> bool:
    """Return whether a value is a number or an array."""
    return isinstance(value, (int, float)) or array_values(value) is not None
