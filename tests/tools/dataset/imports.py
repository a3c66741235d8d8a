"""Trials that are written, changed and imported."""

from dataset_writer import write_trial

from gauge_envs.references.band import load_band
from gauge_envs.references.user_data import DataSource
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials

IMPORTED = {"drivers": "imported", "reference": "imported"}


def imported(root, *only, stated=None):
    """Import a dataset."""
    found = import_trials(find_trials(root, only=only or ("*",)), stated=stated)
    return {one.variant.name: one for one in found}


def import_contents(root, name, contents):
    """Write the trials of a variant and import them."""
    for number, content in enumerate(contents, start=1):
        write_trial(root, name, number, content)
    return imported(root)[name]


def band_of(name):
    band = load_band(name, DataSource.IMPORTED)
    assert band is not None
    return band


MISSING = object()


def put(place, value=MISSING):
    """Puts a value at a place such as `cube.x.4`, or takes away what is there."""
    *path, last = place.split(".")
    sample = last.isdecimal() and len(path) == 2

    def change(content):
        inner = content
        for key in path:
            inner = inner[key]
        key = int(last) if sample else last
        if value is MISSING:
            del inner[key]
        else:
            inner[key] = value
        return content

    return change
