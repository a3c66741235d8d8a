"""Readers of training configurations, one file for each kind of target; a new one is a `Reader` in `READERS`."""

from __future__ import annotations

from gauge_envs.tools.sanity.readers.batched_model import MJX_MODEL, MUJOCO_WARP
from gauge_envs.tools.sanity.readers.dm_control import DM_CONTROL
from gauge_envs.tools.sanity.readers.genesis import GENESIS_OPTIONS, GENESIS_SCENE
from gauge_envs.tools.sanity.readers.gymnasium_env import GYMNASIUM_ENV, GYMNASIUM_ID, GYMNASIUM_VECTOR
from gauge_envs.tools.sanity.readers.isaac_gym import ISAAC_GYM
from gauge_envs.tools.sanity.readers.isaac_lab import ISAAC_LAB
from gauge_envs.tools.sanity.readers.maniskill import MANISKILL
from gauge_envs.tools.sanity.readers.mjlab import MJLAB, MJLAB_CFG, MJLAB_FILE
from gauge_envs.tools.sanity.readers.mujoco_model import MODEL_FILE, MODEL_OBJECT
from gauge_envs.tools.sanity.readers.newton_model import NEWTON_MODEL
from gauge_envs.tools.sanity.readers.playground import PLAYGROUND, PLAYGROUND_ENV
from gauge_envs.tools.sanity.readers.probe import PROBE_FILE
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader
from gauge_envs.tools.sanity.readers.settings import BACKEND, SETTINGS_FILE

__all__ = ["READERS", "GeomPair", "Reader"]

READERS: tuple[Reader, ...] = (
    MODEL_OBJECT,
    NEWTON_MODEL,
    MANISKILL,
    MJX_MODEL,
    MUJOCO_WARP,
    PLAYGROUND_ENV,
    MJLAB_CFG,
    GYMNASIUM_ENV,
    GYMNASIUM_VECTOR,
    DM_CONTROL,
    PLAYGROUND,
    MJLAB,
    MJLAB_FILE,
    MODEL_FILE,
    GENESIS_SCENE,
    # Before settings files, which take every JSON file.
    GENESIS_OPTIONS,
    PROBE_FILE,
    SETTINGS_FILE,
    BACKEND,
    ISAAC_GYM,
    ISAAC_LAB,
    # Takes every text.
    GYMNASIUM_ID,
)
"""All readers; the first one that matches a target reads it."""
