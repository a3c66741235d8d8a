"""Scenes of the experiments as USD, MJCF and OBJ files for other tools."""
