"""Runs of experiments, their results and result files."""
