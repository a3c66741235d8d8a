"""Figures of results, comparisons and error budgets."""
