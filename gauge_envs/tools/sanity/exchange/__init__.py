"""Scenes of a sanity check for other simulators, and the motion that comes back."""
