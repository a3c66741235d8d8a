"""Run the target's own model as it is, against a refined run of the same model and conserved quantities."""
