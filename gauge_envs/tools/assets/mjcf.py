"""Export of MJCF files, whose header names the variant, its parameters and its sources."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.mjcf_reader import DRIVER_PREFIX, driver_rows
from gauge_envs.backends.mujoco.mjcf_writer import (
    add_stiffness_tables,
    exact_xml,
    replay_note,
    start_notes,
    without_rest,
)
from gauge_envs.errors import ResultFileError, UnsupportedSceneError
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.variants import task_path
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.assets.usd_layer import SOURCE


def write_mjcf(experiment: TaskExperiment, path: Path) -> None:
    """Write the MuJoCo model of a variant as a self-contained file in full precision.

    Custom numbers `driver/<body>` hold the motion of driven bodies. Custom numbers `<table>/<body>/...` hold the
    compiled tables of deformable bodies that MuJoCo cannot derive from XML. A comment at the top explains their use.
    """
    text = mjcf_text(experiment)
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be written: {error.strerror or error}: choose another path") from error


def mjcf_text(experiment: TaskExperiment) -> str:
    """Return the text that `write_mjcf` writes."""
    scene = experiment.scene
    if scene.air is not None:
        raise UnsupportedSceneError(
            f"{experiment.id}: MJCF cannot express the air around the cloth: write a USD layer, or export without air"
        )
    simulation = BackendMuJoCo().build(scene)
    notes = [
        f"{experiment.spec.title}: {experiment.id}, parameters: {experiment.parameters}.",
        f"Task file: tasks/{task_path(experiment.variant.family).name}, sha256 {experiment.file_sha256}.",
        SOURCE,
    ]
    notes += start_notes(simulation)
    if scene.deformables:
        notes += add_stiffness_tables(simulation)
    for driver in scene.drivers:
        path = DriverPath(driver, scene, experiment.frame_count)
        rows = driver_rows(simulation, path, round(scene.duration_s / SAMPLE_INTERVAL_S))
        moving = without_rest(rows)
        name = f"{DRIVER_PREFIX}{driver.body}"
        simulation.spec.add_numeric(name=name, size=moving.size, data=moving.ravel().tolist())
        notes.append(replay_note(driver.body, driver.provenance, simulation, moving, len(rows)))
    root = exact_xml(simulation)
    root.set("model", experiment.name)
    comment = ElementTree.Comment("\n    " + "\n    ".join(notes) + "\n  ")
    comment.tail = "\n\n  "
    root.insert(0, comment)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
