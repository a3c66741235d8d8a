"""Run resumable sweeps over engines, settings, parameters and experiments."""
