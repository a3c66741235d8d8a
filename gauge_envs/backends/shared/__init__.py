"""Discretization of deformable bodies, shared by the engines."""
