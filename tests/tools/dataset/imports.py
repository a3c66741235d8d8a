"""Write, change and import trials."""

from dataset_writer import write_trial

from gauge_envs.references.band import load_band
from gauge_envs.references.user_data import DataSource
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials

IMPORTED = {"drivers": "imported", "reference": "imported"}


def imported(root, *only, keep=False):
    """Import a dataset, and return the outcome of each variant; `keep` is that of `import_trials`."""
    layout = find_trials(root, only=only or ("*",))
    return {trials.variant.name: trials for trials in import_trials(layout, keep=keep)}


def import_contents(root, name, contents):
    """Write the trials of a variant and import them."""
    for number, content in enumerate(contents, start=1):
        write_trial(root, name, number, content)
    return imported(root)[name]


def band_of(name):
    band = load_band(name, DataSource.IMPORTED)
    assert band is not None
    return band
