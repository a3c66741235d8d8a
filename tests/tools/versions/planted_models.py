"""A small scene, and workers in this process that change the results of one side."""

import json
import sys
import threading

import numpy as np

from gauge_envs.tools.versions import environments, worker
from gauge_envs.tools.versions.comparison import EXACT
from gauge_envs.tools.versions.schema import Side

SCENE = """<mujoco><option timestep="0.004"/><worldbody><geom name="floor" type="plane" size="3 3 1"/>
<body name="box" pos="0 0 0.0999"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1"/></body>
<body name="arm" pos="0.6 0 0.8"><joint name="elbow" axis="0 1 0"/>
<geom name="arm" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></worldbody>
<actuator><motor name="motor" joint="elbow" ctrlrange="-1 1"/></actuator></mujoco>"""

LOCK = threading.Lock()


def side(title, **settings):
    return Side(title=title, python=sys.executable, settings=settings)


def is_new(side):
    return side.title != "old"


def plant_workers(
    monkeypatch, folder, plant=None, new="", *, model=SCENE, where=is_new
):
    """Run workers in this process, and return a job of 20 steps.

    Args:
        monkeypatch: The fixture of pytest.
        folder: Folder of the models.
        plant: Changes the arrays of a probe in place, on some sides.
        new: Model of sides with a title that begins with `new`.
        model: Model of the remaining sides.
        where: Function of a side: whether the plant changes it.
    """
    for name, text in (("old", model), ("new", new or model)):
        (folder / f"{name}.xml").write_text(text)

    def run_worker(side, job):
        path = folder / f"{side.title[:3]}.xml"
        with LOCK:
            worker.main(json.dumps({**job, "model": str(path)}))
        is_exact = EXACT.items() <= job["settings"].items()
        if plant and job["task"] == "probe" and where(side) and not is_exact:
            with np.load(job["out"]) as stored:
                arrays = dict(stored)
            plant(arrays)
            np.savez(job["out"], **arrays)

    monkeypatch.setattr(environments, "run_worker", run_worker)
    return {"title": "scene", "saved": "", "steps": 20, "seed": 0}
