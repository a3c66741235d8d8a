"""Backends whose episode is a second one after a reset, or one world of a batch, so that faults of these move an id."""

from dataclasses import replace

import numpy as np

from gauge_envs.backends import Backend
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from mutations.mutant import Passed

BEFORE = 90
"""Intervals of the first episode."""
TOGETHER, PLACES = 8, (5, 1, 7)
"""Worlds of a batch, and which of them is the episode."""


class Again(Backend):
    """A backend whose simulations begin a second time.

    Args:
        mutant: A mutant.
        is_restored: Whether they begin by `restore` of the first start in place of `reset`.
    """

    name = "mutant"

    def __init__(self, mutant, *, is_restored):
        self.mutant = mutant
        self.features = mutant.features
        self.is_restored = is_restored

    def versions(self):
        """Return those of the mutant."""
        return self.mutant.versions()

    def supports(self, scene):
        """Return what the mutant supports."""
        return self.mutant.supports(scene)

    def build(self, scene, settings=None):
        """Build a simulation."""
        is_restored = self.is_restored

        class Second(Passed):
            def reset(self, seed):
                self.inner.reset(seed)
                start = self.inner.state() if is_restored else None
                for _ in range(BEFORE):
                    self.inner.advance(SAMPLE_INTERVAL_S)
                if is_restored:
                    self.inner.restore(start)
                else:
                    self.inner.reset(seed)

        return Second(self.mutant.build(scene, settings), scene)


class OneOfMany(Again):
    """A backend whose simulations are one world of a batch of unlike worlds, which have begun before.

    Args:
        mutant: A mutant.
        place: Number of the world.
    """

    def __init__(self, mutant, place):
        super().__init__(mutant, is_restored=False)
        self.place = place

    def build(self, scene, settings=None):
        """Build the worlds."""
        factors = 1.0 + 0.06 * (np.arange(TOGETHER) - self.place)
        scenes = [_unlike(scene, factor) for factor in factors.tolist()]
        return _World(
            self.mutant.build_worlds(scenes, settings), scene, self.place, factors
        )


def _unlike(scene, factor):
    """Return a scene with masses, friction, restitution, start velocities and heights times a factor."""
    bodies = []
    for one in scene.bodies:
        if one in scene.dynamic_bodies:
            x, y, z = one.pose.position_m
            raised = 0.0 if scene.joints else 0.1 * (factor - 1.0)
            one = replace(
                one,
                mass_kg=factor * one.mass_kg,
                pose=replace(one.pose, position_m=(x, y, z + raised)),
                linear_velocity_m_per_s=tuple(
                    (factor * np.array(one.linear_velocity_m_per_s)).tolist()
                ),
                angular_velocity_rad_per_s=tuple(
                    (factor * np.array(one.angular_velocity_rad_per_s)).tolist()
                ),
            )
        bodies.append(one)
    contacts = [
        replace(
            one,
            friction=factor * one.friction,
            restitution=min(factor * one.restitution, 1.0),
        )
        for one in scene.contacts
    ]
    return replace(scene, bodies=tuple(bodies), contacts=tuple(contacts))


class _World(Passed):
    """One world of a batch; the others are driven and commanded with other factors, and restart at other times."""

    def __init__(self, worlds, scene, place, factors):
        super().__init__(worlds.worlds[place], scene)
        self.worlds = worlds
        self.place = place
        self.factors = factors
        self.numbers = np.arange(len(factors))
        self.calls = 0

    def reset(self, seed):
        """Begin a second time: all worlds at once, then this one alone."""
        for _ in range(2):
            self.worlds.reset(seed)
            for _ in range(BEFORE // 6):
                self.worlds.advance(SAMPLE_INTERVAL_S)
        self.worlds.restart(self.place)
        self.calls = 0

    def drive(self, body, pose, velocity, acceleration):
        """Drive all worlds."""
        start = self.scene.body(body).pose.position_m
        moved = np.subtract(pose.position_m, start)
        rates = np.concatenate([velocity, acceleration])
        motions = np.zeros((len(self.factors), 19))
        motions[:, :3] = start + np.outer(self.factors, moved)
        motions[:, 3:7] = pose.quaternion
        motions[:, 7:] = np.outer(self.factors, rates)
        self.worlds.drive(body, motions, self.numbers)

    def command(self, values):
        """Command all worlds."""
        self.worlds.command(np.outer(self.factors, values), self.numbers)

    def advance(self, seconds):
        """Advance all worlds, and restart the next one now and then."""
        self.worlds.advance(seconds)
        self.calls += 1
        if self.calls % 50 == 0:
            self.worlds.restart((self.place + 1) % TOGETHER)
        if self.calls % 50 == 25:
            self.worlds.restart(self.place - 1)

    def body_states(self, names):
        """Return the states of this world."""
        return self.worlds.body_states(names)[self.place]

    def close(self):
        """Close all worlds."""
        self.worlds.close()
