"""A small scene, and a bench that changes what one side computes."""

import json
import sys

import numpy as np

from gauge_envs.tools.versions import worker
from gauge_envs.tools.versions.model import Side
from gauge_envs.tools.versions.processes import READING, Bench, arrays

SCENE = """<mujoco><option timestep="0.004"/><worldbody><geom name="floor" type="plane" size="3 3 1"/>
<body name="box" pos="0 0 0.0999"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1"/></body>
<body name="arm" pos="0.6 0 0.8"><joint name="elbow" axis="0 1 0"/>
<geom name="arm" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></worldbody>
<actuator><motor name="motor" joint="elbow" ctrlrange="-1 1"/></actuator></mujoco>"""


def side(title, **settings):
    return Side(title=title, python=sys.executable, settings=settings)


class Planted(Bench):
    """A bench that works in this process, and changes what the side `new` computes.

    Args:
        plant: Changes the arrays of a probe in place.
        xml: Model of the side `new`; that of the bench if it is empty.
    """

    def __init__(self, folder, plant=None, xml="", **options):
        model = folder / "scene.xml"
        model.write_text(SCENE)
        super().__init__(model, folder, **({"steps": 20, "seed": 0} | options))
        self.plant, self.xml = plant, xml

    def execute(self, side, job, worker_arguments):
        stated = json.loads(job.read_text())
        if side.title.startswith("new") and self.xml:
            changed = job.with_suffix(".xml")
            changed.write_text(self.xml)
            job.write_text(json.dumps(stated | {"model": str(changed)}))
        # The worker reads arrays too, here in a thread of this process.
        with READING:
            worker.main(job)
        for file in job.parent.glob(f"{job.name.partition('.')[0]}.probe*.npz"):
            # The second file of such a job has the solution at its end.
            is_exact = stated.get("exact") and file.stem.endswith("probe1")
            if side.title.startswith("new") and self.plant and not is_exact:
                found = arrays(file)
                self.plant(found)
                np.savez(file, **found)
