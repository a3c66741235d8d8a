"""Faults of batches of worlds, which single simulations do not have."""

from dataclasses import replace

import numpy as np

from gauge_envs.backends.device import DeviceWorlds, HostArrays
from gauge_envs.backends.worlds import Worlds, separate_worlds
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


class _ResetsButLast(Batch):
    """Leaves the last world as it is at a reset, but for the first one."""

    is_fresh = True

    def reset(self, seed):
        for world in self.worlds[: None if self.is_fresh else -1]:
            world.reset(seed)
        self.is_fresh = False


class _RestartsAll(Batch):
    """Restarts all worlds instead of one."""

    def restart(self, number):
        self.inner.reset(0)


class _RestartsNext(Batch):
    """Restarts the next world too."""

    def restart(self, number):
        self.inner.restart(number)
        self.inner.restart((number + 1) % len(self.worlds))


class _Swaps(Batch):
    """Reads world 2 for world 3, and world 3 for world 2."""

    def body_states(self, names):
        states = self.inner.body_states(names)
        states[[2, 3]] = states[[3, 2]]
        return states


class _PushesOthersNoMore(Batch):
    """Removes the wrenches of all worlds before it applies those of some."""

    def apply_wrench(self, body, wrenches, numbers):
        for world in self.worlds:
            world.apply_wrench(body, np.zeros(6))
        self.inner.apply_wrench(body, wrenches, numbers)


class _CommandsAll(Batch):
    """Gives all worlds the first of the commands."""

    def command(self, values, numbers):
        for world in self.worlds:
            world.command(values[0])


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


def _constants_of_first(build, scenes):
    return separate_worlds(
        [build(replace(scene, contacts=scenes[0].contacts)) for scene in scenes]
    )


def _heavy_world(build, scenes):
    """Build worlds, of which the sixth has bodies of 1.5 times the mass."""
    scenes = list(scenes)
    bodies = [replace(one, mass_kg=1.5 * one.mass_kg) for one in scenes[5].bodies]
    scenes[5] = replace(scenes[5], bodies=tuple(bodies))
    return separate_worlds([build(scene) for scene in scenes])


def _raises(build, scenes):
    raise RuntimeError("no batches today")


def _wrapped(kind):
    return lambda build, scenes: kind(
        separate_worlds([build(scene) for scene in scenes])
    )


FAULTS = dict(
    (
        fault(
            "worlds-constants",
            "worlds have the contacts of the first one",
            "worlds-single",
            "constants",
            worlds=_constants_of_first,
        ),
        fault(
            "worlds-reset",
            "reset leaves the last world as it is",
            "worlds-reset",
            "reset must return all worlds",
            worlds=_wrapped(_ResetsButLast),
        ),
        fault(
            "worlds-restart",
            "restart of one world restarts all",
            "worlds-restart",
            "which goes on, differs most",
            worlds=_wrapped(_RestartsAll),
        ),
        fault(
            "worlds-swapped",
            "two worlds are read for each other",
            "worlds-single",
            "differs most, in the velocity",
            worlds=_wrapped(_Swaps),
        ),
        fault(
            "worlds-mass",
            "one world has other masses",
            "worlds-single",
            "world 5 differs most",
            worlds=_heavy_world,
        ),
        fault(
            "worlds-restart-next",
            "restart of one world restarts the next too",
            "worlds-restart",
            "which goes on, differs most",
            worlds=_wrapped(_RestartsNext),
        ),
        fault(
            "worlds-wrench",
            "a wrench on some worlds removes those on others",
            "worlds-wrench",
            "lose it when others",
            worlds=_wrapped(_PushesOthersNoMore),
        ),
        fault(
            "worlds-command",
            "the command of one world goes to all",
            "worlds-command",
            "the command of another world",
            worlds=_wrapped(_CommandsAll),
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
