"""A private copy of the data that the loaders of references read."""

import shutil

import pytest

from gauge_envs.files import data_folder
from gauge_envs.references import tables


@pytest.fixture
def scoring(tmp_path, monkeypatch):
    copy = tmp_path / "scoring"
    shutil.copytree(data_folder("scoring"), copy)
    monkeypatch.setattr(tables, "data_folder", lambda name: tmp_path / name)
    return copy
