"""A stub of the calls of Isaac Sim in examples/isaac_sim. It simulates nothing: a test prescribes the motion."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from types import ModuleType

import pytest
from pxr import Gf, Usd, UsdGeom

NO_STAGE = -1


@dataclass
class StubIsaacSim:
    """Stand-in for Isaac Sim, installed as its modules.

    Attributes:
        motion: Function of the stage and the time after a step [s] that writes poses and points.
        settings: Settings that the script wrote.
        placed: Pose of every kinematic body at each step, by path.
        times_s: Time and length of each step [s].
        log: Calls in their order.
    """

    motion: Callable[[Usd.Stage, float], None]
    settings: dict[str, bool] = field(default_factory=dict)
    placed: dict[str, list[Gf.Matrix4d]] = field(default_factory=dict)
    times_s: list[tuple[float, float]] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    stage: Usd.Stage | None = None
    attached: int = NO_STAGE

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Put modules of Isaac Sim's names where the script imports them."""
        stub = self

        class SimulationApp:
            def __init__(self, launch: dict[str, object]) -> None:
                assert set(launch) == {"headless", "extra_args"}
                assert sys.argv[1:] == [], "Kit reads the arguments that are left"
                stub.log.append("app")

            def update(self) -> None:
                stub.log.append("update")

            def close(self) -> None:
                stub.log.append("close")

        modules = {
            name: ModuleType(name)
            for name in ("isaacsim", "carb", "omni", "omni.usd", "omni.physx")
        }
        modules["isaacsim"].SimulationApp = SimulationApp
        modules["carb"].settings = ModuleType("carb.settings")
        modules["carb"].settings.get_settings = lambda: self
        modules["omni"].usd, modules["omni"].physx = (
            modules["omni.usd"],
            modules["omni.physx"],
        )
        modules["omni.usd"].get_context = lambda: self
        modules["omni.physx"].get_physx_simulation_interface = lambda: self
        for name, module in modules.items():
            monkeypatch.setitem(sys.modules, name, module)

    # --- settings ---

    def set_bool(self, name: str, value: bool) -> None:
        self.settings[name] = value

    # --- stage ---

    def open_stage(self, path: str) -> bool:
        self.log.append("open")
        try:
            self.stage = Usd.Stage.Open(path)
        except Exception:
            return False
        return True

    def get_stage(self) -> Usd.Stage:
        assert self.stage is not None
        return self.stage

    def get_stage_id(self) -> int:
        return 7

    # --- physics ---

    def attach_stage(self, stage_id: int) -> bool:
        self.log.append("attach")
        self.attached = stage_id
        return True

    def simulate(self, interval_s: float, time_s: float) -> None:
        assert self.attached == self.get_stage_id()
        self.times_s.append((time_s, interval_s))
        for prim in self.get_stage().Traverse():
            if prim.GetAttribute("physics:kinematicEnabled").Get():
                # A kinematic target is the pose at the default time; time samples would hide it.
                matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(
                    Usd.TimeCode(1e6)
                )
                self.placed.setdefault(str(prim.GetPath()), []).append(matrix)

    def fetch_results(self) -> None:
        time_s, interval_s = self.times_s[-1]
        self.motion(self.get_stage(), time_s + interval_s)

    def detach_stage(self) -> None:
        self.log.append("detach")
        self.attached = NO_STAGE
