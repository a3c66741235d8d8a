"""Genesis: rigid bodies with its Newton solver, and the deformable bodies of its other solvers."""

from gauge_envs.backends.genesis.backend import BackendGenesis

__all__ = ["BackendGenesis"]
