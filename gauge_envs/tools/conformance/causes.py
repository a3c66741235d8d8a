"""The cause that the results of all checks together suggest: which failed, and which passed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from gauge_envs.tools.conformance.model import CheckResult, Status


class _Cause(NamedTuple):
    """A cause that explains several results.

    Attributes:
        text: The cause.
        fails: Checks that all fail, unless they are unsupported; one of them must have run.
        passes: Checks that do not fail.
    """

    text: str
    fails: Sequence[str]
    passes: Sequence[str] = ()


CAUSES = (
    _Cause(
        "contacts beyond a limit of their number are dropped",
        ["contact-listed", "wall", "tower-stands"],
        ["slide", "hold"],
    ),
    _Cause(
        "pairs collide that Scene.contacts does not list, or listed pairs pass; failures of friction, rest and impacts "
        "may follow from it",
        ["contact-listed"],
        ["free-fall"],
    ),
    _Cause(
        "gravity or its sign differs from the scene's",
        ["free-fall", "pendulum-period"],
        ["glide-speed"],
    ),
    _Cause(
        "free bodies are damped, or their speed is limited",
        ["glide-speed", "tumble-long"],
    ),
    _Cause(
        "the gyroscopic term is missing or of first order in the step, or single precision adds up over many steps",
        ["tumble-long"],
        ["glide-speed", "inertia", "strike-aside"],
    ),
    _Cause(
        "bodies have another inertia or another frame of it",
        ["spin-momentum", "strike-aside", "roll-ball"],
        ["glide-speed", "free-fall"],
    ),
    _Cause(
        "bodies of several parts have another inertia or another frame of it",
        ["spin-momentum", "inertia"],
        ["glide-speed", "wrench-force"],
    ),
    _Cause(
        "apply_wrench acts on another body than the named one",
        ["wrench-force", "inertia", "pendulum-energy"],
        ["worlds-wrench"],
    ),
    _Cause(
        "apply_wrench takes the torque in another frame, as that of the body",
        ["inertia", "stated-inertia"],
        ["wrench-force", "spin-momentum"],
    ),
    _Cause(
        "reset() leaves forces, contacts or warm starts of the run before",
        ["reset-course", "worlds-single", "worlds-reset"],
        ["determinism"],
    ),
    _Cause(
        "friction is a pyramid in scenes of many bodies only, by a preset or a solver for them",
        ["slide-crowd"],
        ["pucks-friction", "slide"],
    ),
    _Cause(
        "friction is a pyramid in place of a cone, or differs between directions",
        ["slide-crowd", "pucks-friction"],
        ["carry-slip"],
    ),
    _Cause(
        "friction differs from Contact.friction everywhere",
        ["slide", "pucks-friction", "slide-crowd"],
    ),
    _Cause(
        "slow bodies that touch are held: by sleep, or by a friction of rest, spin or rolling",
        ["spin-on-point", "roll-ball"],
        ["glide-speed", "pucks-friction", "spin-momentum"],
    ),
    _Cause(
        "bodies on hinges have no contact; free bodies have",
        ["grasp", "rest-shapes"],
        ["contact-listed", "rest-heights", "push-holds"],
    ),
    _Cause(
        "restitution differs from Contact.restitution at every speed",
        ["rebound-0.5", "volley", "strike-aside"],
        ["free-fall"],
    ),
    _Cause(
        "bodies do not rebound below a threshold of speed",
        ["rebound-slow"],
        ["rebound-0.5"],
    ),
    _Cause(
        "contacts yield under many or heavy bodies; light single ones are right",
        ["tower-stands", "mass-ratio"],
        ["rest-heights"],
    ),
    _Cause(
        "worlds of a batch act on each other by contacts or forces",
        ["worlds-single", "worlds-neighbours", "worlds-wrench"],
        ["determinism", "wrench-force"],
    ),
    _Cause(
        "a world of a batch differs from the same scene alone",
        ["worlds-single"],
        ["start-position", "determinism", "starts-free"],
    ),
)
"""Causes, from those that affect most checks to the most special."""


def likely_causes(results: Sequence[CheckResult]) -> list[str]:
    """Return the causes that explain several results, each with the checks that fail and pass by it."""
    status = {result.check: result.status for result in results}
    bad = {result.check for result in results if result.is_bad}
    left = set(bad)
    texts = []
    for cause in CAUSES:
        ran = {
            name
            for name in cause.fails
            if status.get(name, Status.UNSUPPORTED) is not Status.UNSUPPORTED
        }
        right = [name for name in cause.passes if status.get(name) is Status.PASS]
        if not ran or not ran <= left or not bad.isdisjoint(cause.passes):
            continue
        proof = f"fails: {', '.join(sorted(ran))}"
        proof += f"; passes: {', '.join(right)}" if right else ""
        texts.append(f"{cause.text} ({proof})")
        left -= ran
    return texts
