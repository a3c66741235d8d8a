"""Scores of trajectories against references."""
