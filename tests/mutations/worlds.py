"""Faults of batches of worlds, which single simulations do not have."""

from dataclasses import replace

import numpy as np

from gauge_envs.backends.base import Recording, Worlds, separate_worlds
from mutations.mutant import fault


class _Batch(Worlds):
    """Healthy worlds, passed through."""

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


class _ResetsButLast(_Batch):
    """Leaves the last world as it is at a reset, but for the first one."""

    is_fresh = True

    def reset(self, seed):
        for world in self.worlds[: None if self.is_fresh else -1]:
            world.reset(seed)
        self.is_fresh = False


class _RestartsAll(_Batch):
    """Restarts all worlds instead of one."""

    def restart(self, number):
        self.inner.reset(0)


class _RecordsLate(_Batch):
    """Records without the start."""

    can_record = True

    def record(self, names, *, frame_count, samples, interval_s):
        rows = []
        for _ in range((frame_count - 1) * samples + 1):
            self.advance(interval_s)
            rows.append(self.body_states(names))
        rows = np.array(rows)
        return Recording(
            device="cpu", positions_m=rows[..., :3], states=rows[::samples]
        )


def _constants_of_first(build, scenes):
    return separate_worlds(
        [build(replace(scene, contacts=scenes[0].contacts)) for scene in scenes]
    )


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
            "world 3 differs most",
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
            "worlds-record",
            "record without the start",
            "worlds-record",
            "must hold the start",
            worlds=_wrapped(_RecordsLate),
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
