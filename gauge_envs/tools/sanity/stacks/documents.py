"""Read files of strangers: plain values only, within limits. Tags of YAML run nothing.

A training run dumps its configuration with tags of Python. Two of them are data: a tuple, and a slice, which Isaac Lab
writes for every selection of joints. A slice is read as None. Every other tag of Python is refused, unless the reader
takes names of Python as texts and its objects as None.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
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

PLAIN = "tag:yaml.org,2002:"
"""Start of the tags of YAML itself."""

PYTHON = f"{PLAIN}python/"
TUPLE, SLICE = f"{PYTHON}tuple", f"{PYTHON}object/apply:builtins.slice"

_Loader: Any = type("_Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
"""Loader of plain values and tuples, of names of Python as texts, and of its objects as None."""

_Loader.add_constructor(TUPLE, lambda loader, node: tuple(loader.construct_sequence(node, deep=True)))
_Loader.add_multi_constructor(f"{PYTHON}name:", lambda loader, suffix, node: suffix)
_Loader.add_multi_constructor(PYTHON, lambda loader, suffix, node: None)


def file_content(path: Path, most_bytes: int) -> bytes:
    """Return the content of a file that a user names."""
    try:
        return read_regular(path, most_bytes)
    except FileNotFoundError:
        raise TargetError(f"{path}: there is no such file") from None
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None


def file_value(path: Path, parse: Callable[[bytes], Any], most_bytes: int = MEGABYTE) -> Any:
    """Return the value of a file that a user names, by a function that raises `ValueError` for what it cannot parse."""
    content = file_content(path, most_bytes)
    try:
        return parse(content)
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None


def read_yaml(path: Path, *, takes_objects: bool = False) -> Any:
    """Return the value of a YAML file; see `yaml_document`."""
    return file_value(path, partial(yaml_document, takes_objects=takes_objects), MOST_YAML_BYTES)


def yaml_document(content: bytes | str, *, takes_objects: bool = False) -> Any:
    """Return the value of a YAML document.

    Args:
        content: The document.
        takes_objects: Whether names of Python are read as texts and its objects as None, instead of an error.
    """
    raw = content.encode("utf-8", errors="surrogatepass") if isinstance(content, str) else content
    if len(raw) > MOST_YAML_BYTES:
        raise ValueError(f"it has {len(raw)} bytes, the limit is {MOST_YAML_BYTES}")
    text = raw.decode("utf-8")
    try:
        _check(yaml.parse(text, Loader=_Loader), takes_objects)
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise ValueError(f"it is no YAML: {printable(' '.join(str(error).split()))}") from None
    except RecursionError:
        raise ValueError("its tables and lists are nested too deeply") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError) as error:
        # Constructors of plain values assume well-formed dates and numbers.
        raise ValueError(f"a value cannot be read: {printable(str(error))}") from None


def _check(events: Iterable[Any], takes_objects: bool) -> None:
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
            _check_tag(event.tag, line, takes_objects)
            count += 1
            sizes[str(anchor)] = 1
        if isinstance(event, yaml.CollectionStartEvent):
            open_values.append((anchor, count - 1))
        if len(open_values) > MOST_DEPTH:
            raise ValueError(f"line {line}: tables and lists are nested more than {MOST_DEPTH} deep")
        if count > MOST_NODES:
            raise ValueError(f"line {line}: it has more than {MOST_NODES} values, where aliases count in full")


def _check_tag(tag: str | None, line: int, takes_objects: bool) -> None:
    if tag is None or tag in (TUPLE, SLICE) or (tag.startswith(PLAIN) and not tag.startswith(PYTHON)):
        return
    if takes_objects and tag.startswith(PYTHON):
        return
    shown = printable(tag.replace(PLAIN, "!!"))
    reason = "would run code" if tag.startswith(PYTHON) else "is unknown"
    raise ValueError(f"line {line}: the tag {shown} {reason}; only !!python/tuple is data: remove the value or its tag")
