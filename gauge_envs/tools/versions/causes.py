"""Why pip or uv could not install a package: the disk, the network, the version, or no wheel for this Python."""

from __future__ import annotations

import re
import sysconfig
from difflib import get_close_matches

DISK_FULL = r"No space left|os error 28|Errno 28|Errno 122|Errno 27"
NOT_WRITABLE = (
    r"Read-only file system|Permission denied|os error 30|os error 13|Errno 30|Errno 13"
)

UNREACHED = (
    # pip with `-vv`; an index that answers 404 is there, and lacks the package.
    r"Could not fetch URL (?P<place>\S+): (?P<reason>(?!404).*) - skipping",
    r"Failed to fetch: `?(?P<place>[^\s`]+)`?(?P<reason>(\n.*cause: .*)*)",
    r"An index \((?P<place>\S+)\) returned a (?P<reason>.*?) error",
    r"(?P<place>the package index).* (?P<reason>network was disabled)",
    r"(?P<reason>network was disabled)",
)
"""Words of pip and uv where an index does not answer."""

NO_INDEX = r"Ignoring indexes:|provided package locations"
"""Words of pip and uv where the option no-index leaves the folders of find-links alone."""

UNSATISFIED = (
    r"satisfies the requirement (?P<name>\S+)( \(from (?!versions).*?\))? \(from versions: (?P<versions>[^)]*)\)",
    r"there is no version of (?P<name>\S+)",
    r"(?P<name>[\w.=-]+) (was not found|has no usable wheels|has no wheels)",
)
"""Words of pip and uv for a package that they look for in vain."""


def unreached(text: str) -> str | None:
    """Return which index did not answer and why; None if all did."""
    for pattern in UNREACHED:
        if found := re.search(pattern, text):
            place = found.groupdict().get("place") or "the package index"
            reason = _innermost(found["reason"])
            return f"{place} does not answer: {reason}"
    return None


def _innermost(reason: str) -> str:
    """Return the last cause of a chain of them."""
    *_, last = re.split(r"Caused by |Error\('|\] |cause: ", reason.strip())
    last = re.sub(r" for url.*| \([^)]*$", "", last.strip("'\") ."))
    is_proxy = re.search(r"proxy|tunnel", reason, flags=re.I)
    return f"the proxy: {last}" if is_proxy else last


def cause(text: str, requirement: str) -> str:
    """Return why an installation failed.

    Args:
        text: What pip (with `-vv`) or uv printed.
        requirement: What was to be installed, as `mujoco==3.3.0`.
    """
    if re.search(DISK_FULL, text):
        return "the disk is full; free space, or set GAUGE_CACHE_DIR to a folder on another disk"
    if re.search(NOT_WRITABLE, text):
        return f"a folder cannot be written ({last_line(text)}); set GAUGE_CACHE_DIR to another folder"
    if silent := unreached(text):
        return silent
    for pattern in UNSATISFIED:
        if found := re.search(pattern, text):
            name = found["name"].rstrip(",;")
            offered = found.groupdict().get("versions") or ""
            is_needed = name not in (requirement, requirement.partition("==")[0])
            needed = f"it needs {name}: " if is_needed else ""
            return needed + _missing(name, offered, text)
    return last_line(text)


def _missing(name: str, offered: str, text: str) -> str:
    """Return why no file of a package fits."""
    package, _, version = name.partition("==")
    file = rf"/{re.escape(package)}-{re.escape(version)}[-.]"
    python = f"Python {sysconfig.get_python_version()} on {sysconfig.get_platform()}"
    is_for_others = rf"{re.escape(name)} has no (usable )?wheels|(Skipping link|Link requires).*{file}"
    if version and re.search(is_for_others, text):
        return f"there is no wheel of {name} for {python}"
    places = re.search(r"Looking in indexes: (.*)", text)
    where = places[1] if places else "the package index"
    if re.search(NO_INDEX, text):
        where = "the folders of find-links, and no-index switches the package index off"
    versions = [one for one in offered.split(", ") if one not in ("", "none")]
    if versions:
        near = get_close_matches(version, versions, n=3)
        known = ", ".join(dict.fromkeys([*near, versions[-1]]))
        return f"there is no such version in {where}; it has {known}"
    if offered or "was not found" in text:
        return f"there is no package {package} in {where}"
    return f"there is no such version; pip index versions {package} lists those that there are"


def last_line(text: str) -> str:
    """Return the last line with text, of errors if there are any."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.lower().startswith("error")]
    return (errors or lines or ["no message"])[-1]
