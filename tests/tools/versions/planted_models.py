"""A small scene, and a bench that changes the results of one side."""

import json
import sys
import threading

import numpy as np

from gauge_envs.tools.versions import worker
from gauge_envs.tools.versions.comparison import EXACT
from gauge_envs.tools.versions.environments import Bench
from gauge_envs.tools.versions.schema import Side

SCENE = """<mujoco><option timestep="0.004"/><worldbody><geom name="floor" type="plane" size="3 3 1"/>
<body name="box" pos="0 0 0.0999"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1"/></body>
<body name="arm" pos="0.6 0 0.8"><joint name="elbow" axis="0 1 0"/>
<geom name="arm" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></worldbody>
<actuator><motor name="motor" joint="elbow" ctrlrange="-1 1"/></actuator></mujoco>"""

LOCK = threading.Lock()


def side(title, **settings):
    return Side(title=title, python=sys.executable, settings=settings)


class Planted(Bench):
    """A bench with a worker in this process; it changes the results of the side `new`.

    Args:
        folder: Folder of all files.
        plant: Changes the arrays of a probe in place.
        new: Model of the side `new`.
        model: Model of the side `old`.
        steps: Steps of each motion.
        saved: File of saved states.
    """

    def __init__(self, folder, plant=None, new="", *, model=SCENE, steps=20, saved=""):
        for name, text in (("old", model), ("new", new or model)):
            (folder / f"{name}.xml").write_text(text)
        job = {"saved": str(saved), "steps": steps, "seed": 0}
        super().__init__(title="scene", job=job)
        self.folder = folder
        self.plant = plant

    def plant_of(self, side):
        return None if side.title == "old" else self.plant

    def execute(self, side, job):
        model = self.folder / f"{side.title[:3]}.xml"
        with LOCK:
            worker.main(json.dumps({**job, "model": str(model)}))
        plant = self.plant_of(side)
        is_exact = EXACT.items() <= job["settings"].items()
        if plant and job["task"] == "probe" and not is_exact:
            with np.load(job["out"]) as stored:
                arrays = dict(stored)
            description = json.loads(str(arrays["description"]))
            plant(arrays | description)
            np.savez(job["out"], **arrays | {"description": json.dumps(description)})
