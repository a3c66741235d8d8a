"""gauge-envs."""
