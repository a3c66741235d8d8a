"""Sentences about names: the nearest known ones, and the first ones of many."""

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a sentence with the known names nearest to an unknown one, or with some known names."""
    names = sorted(known)
    matches = [n for n in names if fnmatchcase(n, name)]
    if matches:
        return f"one name is expected, as {matches[0]}, and no pattern"
    heads = {f"{n.partition('-')[0]}-*" for n in names} if "*" in name else ()
    near = (
        [n for n in names if n.casefold() == name.casefold()]
        or [n for n in names if n.startswith(name)][:6]
        or get_close_matches(name, [*names, *heads], n=3, cutoff=0.5)
    )
    return (
        f"did you mean {', '.join(near)}?" if near else f"known: {first_names(names)}"
    )


def first_names(names: Sequence[str], max_count: int = 12) -> str:
    """Return names in a line: the first ones and the number of further ones; `none` without names."""
    more = f" and {len(names) - max_count} more" if len(names) > max_count else ""
    return ", ".join(names[:max_count]) + more if names else "none"
