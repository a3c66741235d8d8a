"""Metrics of a motion: distance to the real mean, events of a swing, agreement with physical laws."""
