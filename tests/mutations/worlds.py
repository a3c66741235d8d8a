"""Faults of batches of worlds, which single simulations do not have."""

import numpy as np

from gauge_envs.backends.device import DeviceWorlds, HostArrays
from gauge_envs.backends.worlds import SeparateWorlds, Worlds
from mutations.mutant import fault


class Batch(Worlds):
    """Healthy worlds, passed through.

    Args:
        inner: The worlds.
    """

    def __init__(self, inner):
        self.inner = inner
        self.worlds = inner.worlds

    def reset(self, seed):
        """Pass on."""
        self.inner.reset(seed)

    def advance(self, seconds):
        """Pass on."""
        self.inner.advance(seconds)

    def close(self):
        """Pass on."""
        self.inner.close()


class _PushesOthersNoMore(Batch):
    """Removes the wrenches of all worlds before it applies those of some."""

    def apply_wrench(self, body, wrenches, numbers):
        for world in self.worlds:
            world.apply_wrench(body, np.zeros(6))
        self.inner.apply_wrench(body, wrenches, numbers)


class _OnHost(HostArrays, DeviceWorlds):
    """Worlds whose device is the host, and which ignore where they shall begin."""

    def __init__(self, worlds):
        self._worlds = worlds

    def begin(self, states):
        self._worlds.reset(0)

    def drive(self, body, motions):
        self._worlds.drive(body, motions, np.arange(len(motions)))

    def advance(self, seconds):
        self._worlds.advance(seconds)

    def body_states(self, names):
        return self._worlds.body_states(names)


class _BeginsAsBuilt(Batch):
    """Has a device that ignores given starts."""

    def on_device(self):
        return _OnHost(self.inner)


def _raises(build, scenes):
    raise RuntimeError("no batches today")


def _wrapped(kind):
    return lambda build, scenes: kind(
        SeparateWorlds([build(scene) for scene in scenes])
    )


FAULTS = dict(
    (
        fault(
            "worlds-wrench",
            "a wrench on some worlds removes those on others",
            "worlds-wrench",
            "lose it when others",
            worlds=_wrapped(_PushesOthersNoMore),
        ),
        fault(
            "worlds-device",
            "worlds on a device begin as built",
            "worlds-device",
            "at the given states",
            worlds=_wrapped(_BeginsAsBuilt),
        ),
    )
)
"""Faults by id."""

RAISES = fault(
    "worlds-raise",
    "build_worlds raises an error",
    "worlds-single",
    "no batches",
    worlds=_raises,
)[1]
"""A fault that ends in an error, not in a failure."""
