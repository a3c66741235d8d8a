"""MuJoCo simulations that advance in one call, whose worlds are no simulations of their own."""

from gauge_envs.backends.world import World
from gauge_envs.backends.worlds import Worlds


class OneOfMany(World):
    """A world that is no simulation of its own, as those of Newton."""

    def __init__(self, simulation):
        self.simulation = simulation
        self.settings = simulation.settings

    def drive(self, *arguments):
        self.simulation.drive(*arguments)

    def body_states(self, names):
        return self.simulation.body_states(names)

    def nodes(self, name):
        return self.simulation.nodes(name)

    def track(self, name, points_m):
        return self.simulation.track(name, points_m)


class Together(Worlds):
    """MuJoCo simulations that advance in one call."""

    def __init__(self, simulations):
        self.worlds = [OneOfMany(simulation) for simulation in simulations]

    def reset(self, seed):
        for world in self.worlds:
            world.simulation.reset(seed)

    def advance(self, seconds):
        for world in self.worlds:
            world.simulation.advance(seconds)

    def close(self):
        for world in self.worlds:
            world.simulation.close()
