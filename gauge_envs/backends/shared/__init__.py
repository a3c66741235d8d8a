"""Discretization of deformable bodies, shared by the backends."""
