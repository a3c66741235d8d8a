"""Compare two releases of an engine on one model: what changed, and which side is right."""
