"""Ctrl-C at a chosen place of a run."""

from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo


def interrupt_in_episode(monkeypatch, number):
    """Ctrl-C while an episode is being stepped: the engine raises KeyboardInterrupt in the given one."""
    count = 0
    reset, states = SimulationMuJoCo.reset, SimulationMuJoCo.body_states

    def counted(self, starts=None, seed=0):
        nonlocal count
        count += 1
        reset(self, starts, seed)

    def interrupted(self, names):
        if count == number:
            raise KeyboardInterrupt
        return states(self, names)

    monkeypatch.setattr(SimulationMuJoCo, "reset", counted)
    monkeypatch.setattr(SimulationMuJoCo, "body_states", interrupted)
