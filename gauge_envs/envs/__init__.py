"""Gymnasium and dm_env environments."""
