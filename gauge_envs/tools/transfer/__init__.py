"""Replay policies elsewhere, and show what uncertain inputs do to a reward."""
