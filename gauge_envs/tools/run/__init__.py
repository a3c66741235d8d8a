"""Run experiments once or in all combinations, and score them; score trajectories from files."""
