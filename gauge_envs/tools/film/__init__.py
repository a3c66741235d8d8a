"""Films and strips of results: engines side by side, each with the reference that it is scored against."""
