"""Policies of other packages, as functions from an observation to an action."""
