"""Sweeps: many engines, settings, parameters and experiments, planned as a table, and resumable."""
