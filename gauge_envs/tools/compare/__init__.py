"""Compare engines, parameters and settings within each grade of reference."""
