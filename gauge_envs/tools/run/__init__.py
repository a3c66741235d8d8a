"""Run experiments and score them; score trajectories from files."""
