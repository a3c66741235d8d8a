"""Readers of training configurations, one file for each kind of target; a new one is a `Reader` in `READERS`."""

from __future__ import annotations

from gauge_envs.checks.sanity.readers.dm_control import DM_CONTROL
from gauge_envs.checks.sanity.readers.genesis import GENESIS_OPTIONS, GENESIS_SCENE
from gauge_envs.checks.sanity.readers.gymnasium_env import GYMNASIUM_ENV, GYMNASIUM_ID
from gauge_envs.checks.sanity.readers.mujoco_model import MODEL_FILE, MODEL_OBJECT
from gauge_envs.checks.sanity.readers.reader import GeomPair, Reader
from gauge_envs.checks.sanity.readers.settings import BACKEND, SETTINGS_FILE

__all__ = ["READERS", "GeomPair", "Reader"]

READERS: tuple[Reader, ...] = (
    MODEL_OBJECT,
    GYMNASIUM_ENV,
    DM_CONTROL,
    MODEL_FILE,
    GENESIS_SCENE,
    # Before settings files, which take every JSON file.
    GENESIS_OPTIONS,
    SETTINGS_FILE,
    BACKEND,
    # Takes every text.
    GYMNASIUM_ID,
)
"""All readers; the first one that matches a target reads it."""
