"""Trajectories of other simulators: their files, likely mistakes in them, and lost markers."""
