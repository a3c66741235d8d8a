"""Checks that run the target's own model, and of what drives its joints."""
