"""Read a YAML file of a stranger: plain values only, within limits. Tags run nothing.

A training run dumps its configuration with tags of Python. Two of them are data: a tuple, and a slice, which Isaac Lab
writes for every selection of joints. A slice is read as None. Every other tag of Python is refused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, printable, read_regular

MOST_YAML_BYTES = MEGABYTE
"""Largest size of a YAML file. Dumps of training runs have some 30 kB."""

MOST_DEPTH = 64
"""Largest depth of nested tables and lists."""

MOST_NODES = 50_000
"""Largest count of values, where each alias counts as all that it stands for."""

TUPLE = "tag:yaml.org,2002:python/tuple"
SLICE = "tag:yaml.org,2002:python/object/apply:builtins.slice"
PLAIN = "tag:yaml.org,2002:"
"""Start of the tags of YAML itself."""

PYTHON = "tag:yaml.org,2002:python/"

_Loader: Any = type("_Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
"""Loader of plain values, tuples, and slices as None."""

_Loader.add_constructor(TUPLE, lambda loader, node: tuple(loader.construct_sequence(node, deep=True)))
_Loader.add_constructor(SLICE, lambda loader, node: None)


def read_yaml(path: Path) -> Any:
    """Return the value of a YAML file."""
    try:
        return yaml_document(read_regular(path, MOST_YAML_BYTES))
    except FileNotFoundError:
        raise TargetError(f"{path}: there is no such file") from None
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None


def yaml_document(content: bytes | str) -> Any:
    """Return the value of a YAML document."""
    raw = content.encode("utf-8", errors="surrogatepass") if isinstance(content, str) else content
    if len(raw) > MOST_YAML_BYTES:
        raise ValueError(f"it has {len(raw)} bytes, the limit is {MOST_YAML_BYTES}")
    text = raw.decode("utf-8")
    try:
        _check(yaml.parse(text, Loader=_Loader))
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise ValueError(f"it is no YAML: {printable(' '.join(str(error).split()))}") from None
    except RecursionError:
        raise ValueError("its tables and lists are nested too deeply") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError) as error:
        # Constructors of plain values assume well-formed dates and numbers.
        raise ValueError(f"a value cannot be read: {printable(str(error))}") from None


def _check(events: Iterable[Any]) -> None:
    """Check the size, the depth and the tags of a document before its values are built."""
    sizes: Counter[str] = Counter()
    open_values: list[tuple[str | None, int]] = []
    count = 0
    for event in events:
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, start = open_values.pop()
            sizes[str(anchor)] = count - start
        if not isinstance(event, yaml.NodeEvent):
            continue
        line, anchor = event.start_mark.line + 1, event.anchor
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == one for one, _ in open_values):
                raise ValueError(f"line {line}: a value contains itself")
            count += sizes[str(anchor)]
        else:
            _check_tag(event.tag, line)
            count += 1
            sizes[str(anchor)] = 1
        if isinstance(event, yaml.CollectionStartEvent):
            open_values.append((anchor, count - 1))
        _check_limits(count, len(open_values), line)


def _check_limits(count: int, depth: int, line: int) -> None:
    if depth > MOST_DEPTH:
        raise ValueError(f"line {line}: tables and lists are nested more than {MOST_DEPTH} deep")
    if count > MOST_NODES:
        raise ValueError(f"line {line}: it has more than {MOST_NODES} values, where aliases count in full")


def _check_tag(tag: str | None, line: int) -> None:
    if tag is None or tag in (TUPLE, SLICE) or (tag.startswith(PLAIN) and not tag.startswith(PYTHON)):
        return
    shown = printable(tag.replace(PLAIN, "!!"))
    reason = "would run code" if tag.startswith(PYTHON) else "is unknown"
    raise ValueError(f"line {line}: the tag {shown} {reason}; only !!python/tuple is data: remove the value or its tag")
