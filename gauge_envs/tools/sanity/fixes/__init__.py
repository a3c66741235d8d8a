"""Find the change of settings that resolves most checks, and write it into the text of a model."""
