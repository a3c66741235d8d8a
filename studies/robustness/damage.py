"""Damage files: bytes at random, and the structure of texts, JSON documents and archives."""

from __future__ import annotations

import io
import json
import random
import re
import zipfile
from collections.abc import Callable
from functools import lru_cache
from typing import Any

Damage = Callable[[bytes, random.Random], bytes]

NUMBERS = (
    *(
        b"nan",
        b"-inf",
        b".inf",
        b"1e999",
        b"-1e308",
        b"1e-320",
        b"0",
        b"-0.0",
        b"-1",
        b"0.1",
        b"1e9",
        b"1000000000",
    ),
    *(
        b"9223372036854775808",
        b"-9223372036854775809",
        b"9" * 400,
        b"9" * 10_000,
        b"0x" + b"f" * 9000,
        b"0." + b"1" * 5000,
    ),
    *(
        b"1:30:59.5",
        b"1_000",
        b"true",
        b"null",
        b'"1"',
        b"[]",
        b"{}",
        b"1" * 64 + b".5",
        b"\xd9\xa3",
    ),
)
"""What takes the place of a number; the last is a digit of another script."""

TOKENS = (
    *NUMBERS,
    *(
        b"!!python/object/apply:os.abort []",
        b"!!python/tuple ",
        b"&a [*a]",
        b"*p",
        b"<<: *p",
        b"${sim.dt}",
        b"\t",
        b": ",
    ),
    *(
        b'"',
        b"'",
        b"{",
        b"}",
        b"[",
        b"]",
        b"[" * 5000,
        b'{"a":' * 3000,
        b"a." * 3000,
        b"\x00",
        b"\xff\xfe",
        b",",
        b"=",
        b"\r",
    ),
    *(
        b"\x1b[2J",
        b"\n# heading\n",
        b"$\\frac{$",
        b":smile:",
        b"~nosuchuser/x",
        b"../../../etc/passwd",
    ),
)

VALUES: tuple[Any, ...] = (
    *(
        None,
        True,
        "",
        "a\x00b",
        "\ud800",
        "x" * 10_000,
        "../../../etc/passwd",
        "nan",
        [],
        {},
        [[]],
        [None],
        {"": 0},
    ),
    *(
        0,
        -1,
        -0.0,
        0.5,
        1e308,
        5e-324,
        float("nan"),
        float("inf"),
        2**63,
        -(2**64),
        10**400,
        10**9,
    ),
)
"""What takes the place of a value of a JSON document."""

DEEP = "a value that is nested deeply"

NUMBER = re.compile(rb"(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?")
KEY = re.compile(rb'"?(?<![\w.])[A-Za-z_][\w.]{0,64}"?(?=\s{0,8}[=:])')


def in_bytes(content: bytes, chance: random.Random) -> bytes:
    """Change, cut, repeat or exchange parts at random, and put tokens in."""
    values = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 8))):
        size = len(values)
        place, other = chance.randrange(size + 1), chance.randrange(size + 1)
        length = chance.choice((1, 2, 4, 16, 64, 1024))
        kind = chance.randrange(7)
        if kind == 0 and place < size:
            values[place] = chance.randrange(256)
        elif kind == 1:
            del values[place : place + length]
        elif kind == 2:
            values[place:place] = values[other : other + length] * chance.choice(
                (1, 2, 50)
            )
        elif kind == 3:
            values[place : place + length] = values[other : other + length]
        elif kind == 4:
            values[place:place] = chance.choice(TOKENS)
        elif kind == 5:
            values[place : place + length] = chance.choice(TOKENS)
        elif chance.random() < 0.2:
            del values[place:]
    return bytes(values)


def in_text(content: bytes, chance: random.Random) -> bytes:
    """Replace numbers, drop, repeat and move lines, exchange keys, nest values; or change bytes."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        kind = chance.randrange(6)
        if kind in (0, 1):
            content = _replaced(
                content, NUMBER, chance, lambda found: chance.choice(NUMBERS)
            )
        elif kind == 2:
            keys = KEY.findall(content[:10_000]) or [b"a"]
            content = _replaced(
                content, KEY, chance, lambda found, keys=keys: chance.choice(keys)
            )
        elif kind == 3:
            depth = chance.choice((1, 2, 60, 70, 900, 3000))
            content = _replaced(
                content,
                NUMBER,
                chance,
                lambda found, depth=depth: b"[" * depth + found + b"]" * depth,
            )
        elif kind == 4:
            content = _moved_lines(content, chance)
        else:
            content = in_bytes(content, chance)
    return content


def _replaced(
    content: bytes,
    pattern: re.Pattern[bytes],
    chance: random.Random,
    other: Callable[[bytes], bytes],
) -> bytes:
    """Replace the first match after a random place."""
    found = pattern.search(
        content, chance.randrange(len(content) + 1)
    ) or pattern.search(content)
    return (
        content
        if found is None
        else content[: found.start()] + other(found[0]) + content[found.end() :]
    )


def _moved_lines(content: bytes, chance: random.Random) -> bytes:
    lines = content.split(b"\n")
    place, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    kind = chance.randrange(4)
    if kind == 0:
        del lines[place]
    elif kind == 1:
        lines.insert(other, lines[place])
    elif kind == 2:
        lines[place], lines[other] = lines[other], lines[place]
    else:
        lines[place] = b" " * chance.choice((1, 2, 4)) + lines[place]
    return b"\n".join(lines)


@lru_cache(maxsize=16)
def _document(content: bytes) -> Any:
    return json.loads(content)


def in_json(content: bytes, chance: random.Random) -> bytes:
    """Replace, drop, repeat and rename values at random places of a document; or damage its text."""
    if chance.random() < 0.3:
        return in_text(content, chance)
    value = _document(content)
    for _ in range(chance.choice((1, 1, 2, 4))):
        value = _changed(value, chance, value)
    depth = chance.choice((30, 900, 5000))
    text = json.dumps(value).replace(json.dumps(DEEP), "[" * depth + "]" * depth)
    return text.encode("utf-8", errors="surrogatepass")


def _changed(value: Any, chance: random.Random, whole: Any) -> Any:
    """Return a copy of a value that differs at one place; what stays is shared with the original."""
    if not (isinstance(value, dict | list) and value) or chance.random() < 0.15:
        return chance.choice((*VALUES, DEEP, whole if len(str(whole)) < 10_000 else 0))
    key = (
        chance.choice(list(value))
        if isinstance(value, dict)
        else chance.randrange(len(value))
    )
    copy = value.copy()
    kind = chance.random()
    if kind < 0.1:
        del copy[key]
    elif kind < 0.2 and isinstance(copy, dict):
        copy[chance.choice(["", "a", *value])] = copy.pop(key)
    elif kind < 0.2:
        copy[key:key] = [value[key]] * chance.choice((1, 2, 100))
    else:
        copy[key] = _changed(value[key], chance, whole)
    return copy


def in_archive(content: bytes, chance: random.Random) -> bytes:
    """Damage, drop, rename or repeat a member of an archive, or damage the archive."""
    if chance.random() < 0.2:
        return in_bytes(content, chance)
    members = list(_members(content))
    number = chance.randrange(len(members))
    name, inner = members[number]
    kind = chance.random()
    if kind < 0.1:
        del members[number]
    elif kind < 0.2:
        members[number] = (
            chance.choice(("../a", "/a", "", "a" * 5000, members[0][0])),
            inner,
        )
    elif kind < 0.25:
        members.append((name, inner))
    else:
        members[number] = (name, _damage_of(inner)(inner, chance))
    stream = io.BytesIO()
    with zipfile.ZipFile(
        stream, "w", chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    ) as archive:
        for name, inner in members:
            archive.writestr(zipfile.ZipInfo(name), inner)
    return stream.getvalue()


@lru_cache(maxsize=16)
def _members(content: bytes) -> tuple[tuple[str, bytes], ...]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return tuple((name, archive.read(name)) for name in archive.namelist())


def _damage_of(inner: bytes) -> Damage:
    if inner.startswith(b"PK"):
        return in_archive
    if inner.startswith(b"\x93NUMPY"):
        return _in_npy
    return in_json if inner.startswith(b"{") else in_bytes


def _in_npy(content: bytes, chance: random.Random) -> bytes:
    """Damage the header of an NPY file, of the same length, or the rest."""
    end = content.find(b"\n") + 1
    if chance.random() < 0.3:
        return content[:end] + in_bytes(content[end:], chance)
    head = (
        in_text(content[10:end], chance)
        if chance.random() < 0.7
        else in_bytes(content[10:end], chance)
    )
    return (
        content[:8]
        + min(len(head), 0xFFFF).to_bytes(2, "little")
        + head
        + content[end:]
    )
