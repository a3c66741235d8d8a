"""The scenes of checks as MJCF and USD files, and verdicts on the motions that another program makes of them."""

import csv
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.backends import Simulation
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.mjcf import scene_mjcf_text
from gauge_envs.backends.shared.rigid import placed_states
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.fixtures.recording import Recording, UnsupportedError
from gauge_envs.pages.document import save_file
from gauge_envs.reading import reading
from gauge_envs.registry import package_versions
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.text import json_document
from gauge_envs.tools.conformance.catalog import checks
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Level, Status
from gauge_envs.tools.conformance.results import EngineColumn
from gauge_envs.tools.conformance.run import run_check

TABLE = "checks.json"
CALLS = "it needs more of an engine than the motion of rigid bodies"
COLUMNS = ("time_s", *"xyz", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz")
"""Columns of a motion beside `body`: time, and state as in `Simulation.body_states`."""


class _Scenes(Lab):
    """The scenes that a check runs, on MuJoCo or with motions of files.

    Args:
        motions: Files of the motions, in the order of the scenes; None runs the scenes.

    Attributes:
        runs: Each scene, with its sample times, moving bodies and constant wrenches.
    """

    def __init__(self, motions: Sequence[Path] | None = None) -> None:
        super().__init__(BackendMuJoCo())
        self.runs: list[tuple[Scene, dict[str, Any]]] = []
        self._motions = motions

    def build(self, *_: Any, **__: Any) -> Simulation:
        """Reject checks that call an engine otherwise than by `rollout`."""
        raise UnsupportedError((CALLS,))

    def rollout(
        self,
        scene: Scene,
        seconds: float | None = None,
        *,
        interval_s: float = SAMPLE_INTERVAL_S,
        wrenches: Mapping[str, ArrayLike] = {},
        **changes: Any,
    ) -> Recording:
        """List a scene, and return its recording; see `Lab.rollout`."""
        is_slow = scene.drivers and interval_s != SAMPLE_INTERVAL_S
        if changes or scene.deformables or is_slow:
            raise UnsupportedError((CALLS,))
        whole_s = scene.duration_s if seconds is None else seconds
        moving = [body for body in scene.bodies if body.motion is not Motion.FIXED]
        run = {
            "interval_s": interval_s,
            "samples": round(whole_s / interval_s) + 1,
            "bodies": [body.name for body in moving],
            "wrenches": {
                name: np.ravel(row).tolist() for name, row in wrenches.items()
            },
        }
        self.runs.append((scene, run))
        if self._motions is not None:
            return _read_motion(self._motions[len(self.runs) - 1], scene, run)
        lab = Lab(self.backend)
        return lab.rollout(scene, whole_s, interval_s=interval_s, wrenches=wrenches)


def _read_motion(path: Path, scene: Scene, run: Mapping[str, Any]) -> Recording:
    """Return the motion of a scene from a file."""
    if not path.exists():
        raise UnsupportedError((f"there is no {path.name}",))
    times_s = run["interval_s"] * np.arange(run["samples"])
    rows: dict[str, list[list[float]]] = {name: [] for name in run["bodies"]}
    states = {
        name: np.tile(state, (len(times_s), 1))
        for name, state in placed_states(scene).items()
    }
    with reading(path, ResultFileError) as content:
        for row in csv.DictReader(content.decode().splitlines()):
            rows[row["body"]].append([float(row[key]) for key in COLUMNS])
        for name, table in rows.items():
            seen_s = [row[0] for row in table]
            if len(seen_s) != len(times_s) or not np.allclose(seen_s, times_s):
                raise ValueError(
                    f"{name!r} needs {len(times_s)} rows, each {run['interval_s']:.6g} s after the last, from 0 s"
                )
            states[name] = np.array(table)[:, 1:]
    return Recording(scene=scene, times_s=times_s, states=states)


def export_scenes(folder: Path, only: Sequence[str]) -> list[str]:
    """Write the scenes of checks as MJCF and USD files, and their laws as `checks.json`.

    Args:
        folder: The folder.
        only: Ids or patterns of checks; all when empty.

    Returns:
        Ids of the checks. Those that need more than the motion of rigid bodies are left out.

    Raises:
        ParameterError: No check is left.
        ResultFileError: The folder cannot be written.
    """
    table = {}
    runs = {}
    for check in checks(only):
        if check.level not in (Level.RIGID, Level.CONTACT):
            continue
        lab = _Scenes()
        result = run_check(lab, check)
        if result.status is Status.UNSUPPORTED:
            continue
        names = [f"{check.id}-{number}" for number in range(1, len(lab.runs) + 1)]
        for name, (scene, run) in zip(names, lab.runs, strict=True):
            runs[name] = run
            _write(folder, name, scene)
        table[check.id] = result.to_dict() | {"runs": names}
    if not table:
        raise ParameterError(f"{', '.join(only)} has no scene for a file: {CALLS}")
    version = package_versions()["gauge-envs"]
    document = {"gauge_envs": version, "checks": table, "runs": runs}
    save_file(folder / TABLE, json.dumps(document, indent=1) + "\n")
    return [*table]


def _write(folder: Path, name: str, scene: Scene) -> None:
    """Write a scene as MJCF, and as USD unless it has compounds."""
    # A judge of motions does not need this extra.
    from gauge_envs.formats.usd import scene_stage

    save_file(folder / f"{name}.xml", scene_mjcf_text(scene, name, 0))
    with suppress(ParameterError):
        stage = scene_stage(scene)
        save_file(folder / f"{name}.usda", stage.GetRootLayer().ExportToString())


def judge_motions(folder: Path, only: Sequence[str]) -> EngineColumn:
    """Return the results of motions that another program wrote beside exported scenes.

    Raises:
        ResultFileError: The table cannot be read, or is of other checks.
    """
    column = EngineColumn(backend=folder.name, name="default", settings={})
    hint = "write it with gauge backend check --export DIR"
    with reading(folder / TABLE, ResultFileError, "a table of checks", hint) as content:
        document = json_document(content)
        table = document["checks"]
        column.versions = {"scenes": document["gauge_envs"]}
    for check in checks(only):
        entry = table.get(check.id)
        if entry is None:
            continue
        if entry["fingerprint"] != check.fingerprint:
            raise ResultFileError(f"{folder}: {check.id} has changed since; {hint}")
        lab = _Scenes([folder / f"{name}.csv" for name in entry["runs"]])
        column.results[check.id] = replace(
            run_check(lab, check), backend=column.backend, versions=column.versions
        )
    return column
