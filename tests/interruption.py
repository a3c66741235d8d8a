"""Ctrl-C at a chosen place of a run."""

from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo


def interrupt_in_episode(monkeypatch, number):
    """Send Ctrl-C while MuJoCo advances the given episode: the first, second, ... advancing simulation."""
    advance, simulations = SimulationMuJoCo.advance, []

    def interrupted(self, seconds):
        if self not in simulations:
            simulations.append(self)
        if len(simulations) == number:
            raise KeyboardInterrupt
        advance(self, seconds)

    monkeypatch.setattr(SimulationMuJoCo, "advance", interrupted)
