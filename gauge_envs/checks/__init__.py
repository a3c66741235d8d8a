"""Checks of engines: conformance to closed forms, and sanity of training configurations."""
