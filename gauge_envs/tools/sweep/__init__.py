"""Sweeps: many engines, settings, parameters and experiments, planned as a table, resumable, and stored."""
