"""Find the sides that names say, and the parts of a model that are each other's mirror."""

from __future__ import annotations

import re
from collections import defaultdict
from typing import NamedTuple

import mujoco

from gauge_envs.tools.sanity.robot.model_text import COUNTS

WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")

LEFT, RIGHT = ("left", "l"), ("right", "r")
"""Words for the sides."""

ENDS = {"f": "front", "r": "rear", "h": "hind", "b": "back"}

CORNERS = {
    code: (side, word)
    for end, word in ENDS.items()
    for side in "lr"
    for code in (end + side, side + end)
}
"""Side and end of the legs of quadrupeds by their codes, such as `FL` and `LF`."""


class Side(NamedTuple):
    """What a name says.

    Attributes:
        side: `l`, `r`, or empty.
        stem: The name without its side.
    """

    side: str
    stem: str


def side_of(name: str) -> Side:
    """Return the side that a name says, and the rest of it; no side for a name with both."""
    sides, stem, words = list[str](), list[str](), WORDS.findall(name)
    for number, word in enumerate(words):
        text, found = word.lower(), ""
        is_code = word.isupper() or number in (0, len(words) - 1)
        if text in LEFT + RIGHT:
            found, text = text[0], "*"
        elif text in CORNERS and is_code:
            found, text = CORNERS[text]
        elif match := re.match(r"(left|right)(..+)", text):
            found, text = text[0], match[2]
        if found:
            sides.append(found)
        stem.append(text)
    return Side(sides[0] if len(set(sides)) == 1 else "", " ".join(stem))


def limb_of(name: str) -> str:
    """Return a name without its side and end: that of the like parts of all legs."""
    words = side_of(name).stem.split()
    return " ".join(word for word in words if word not in ENDS.values())


def mirrored(model: mujoco.MjModel, kind: str) -> list[tuple[int, int]]:
    """Return pairs of elements of a kind whose names differ by the side alone, the left one first."""
    stems: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for number in range(getattr(model, COUNTS.get(kind, f"n{kind}"))):
        name = getattr(model, kind)(number).name
        side = side_of(name)
        if name and side.side:
            stems[side.stem][side.side].append(number)
    return [
        (sides["l"][0], sides["r"][0])
        for sides in stems.values()
        if len(sides["l"]) == len(sides["r"]) == 1
    ]
