"""Comparison of results, and the parts of an error."""
