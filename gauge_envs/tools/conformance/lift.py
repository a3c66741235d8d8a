"""Deformable bodies that hang on one frame, which stands still and then moves with a constant velocity.

On a frame with a constant velocity a body hangs as on one at rest (Galilei). So a law that is measured in both phases
shows constants that depend on time, speed or place, and attachments that drift. Several bodies with other constants
show an engine that gives all of them those of one.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gauge_envs.scene import Motion, Region, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.profiles import TrapezoidProfile
from gauge_envs.tools.bench.parts import driver, fixed_box
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import FRAME
from gauge_envs.tools.conformance.laws import (
    PLACE_TOLERANCE_M,
    furthest,
    largest_mm,
    worst_ratio,
)
from gauge_envs.tools.conformance.model import Measurement, Recorded, rollout_of

HELD_M = 1e-7
"""Displacement below which a node is held [m]; single precision at 1 m."""

APART_M = 1.0
RAMP_S = 0.8
BRAKE_S = 0.1
"""The frame brakes after the end of the scene."""
BYSTANDERS = tuple(
    fixed_box(f"bystander {number}", (2.0, 0.3 * number, 0.5), (0.02, 0.02, 0.02))
    for number in range(5)
)
"""Bodies that touch nothing. What hangs beside them hangs as without them."""


@dataclass(frozen=True)
class Lift:
    """Scenes of one clamped body each, side by side on one frame.

    Attributes:
        scenes: Scenes that `lab.clamped` returns, by the name of their body here. The frame stands still for the
            duration of the first.
        speed_m_per_s: Speed of the frame at the end, upward, which it reaches within `RAMP_S`. The load of its
            acceleration should not exceed twice the weight.
        late_s: Time for which the frame keeps this speed [s].
    """

    scenes: Mapping[str, Scene]
    speed_m_per_s: float
    late_s: float

    @property
    def still_s(self) -> float:
        """Time for which the frame stands still [s]."""
        return next(iter(self.scenes.values())).duration_s

    @property
    def scene(self) -> Scene:
        """The scene of all bodies."""
        first = next(iter(self.scenes.values()))
        duration_s = RAMP_S + self.late_s + BRAKE_S
        rise = TrapezoidProfile(
            start_s=self.still_s,
            duration_s=duration_s,
            accelerate_s=RAMP_S,
            brake_s=BRAKE_S,
            amount=self.speed_m_per_s * (duration_s - 0.5 * (RAMP_S + BRAKE_S)),
        )
        bodies, attachments = [], []
        for number, (name, scene) in enumerate(self.scenes.items()):
            (body,) = scene.deformables
            place = np.add(body.pose.position_m, (0.0, APART_M * number, 0.0))
            pose = replace(body.pose, position_m=vector(place))
            bodies.append(replace(body, name=name, pose=pose))
            attachments += [replace(one, deformable=name) for one in scene.attachments]
        return replace(
            first,
            bodies=(replace(FRAME, motion=Motion.KINEMATIC), *BYSTANDERS),
            deformables=tuple(bodies),
            attachments=tuple(attachments),
            drivers=(driver(FRAME.name, "translate", (0.0, 0.0, 1.0), rise),),
            duration_s=self.still_s + RAMP_S + self.late_s,
        )

    def recorded(self, scene: str) -> Recorded[Recording]:
        """Return the rollout of the scene; its first body stands still in words already."""
        text = f"{scene}; their frame then moves up with {self.speed_m_per_s:g} m/s"
        return rollout_of(text, self.scene)

    def part(
        self, rollout: Recording, name: str, start_s: float, end_s: float
    ) -> Recording:
        """Return the rollout of one body as in its own scene, relative to the frame.

        The sample at the start of the whole rollout comes first, then those from one time to another. Their times
        count on as if the body had settled before.
        """
        scene = self.scenes[name]
        (body,) = scene.deformables
        number = list(self.scenes).index(name)
        window = rollout.between(start_s, end_s)
        moved = rollout.displacement(FRAME.name)[:, None]
        nodes = rollout.nodes_m[name] - moved - (0.0, APART_M * number, 0.0)
        times_s = rollout.times_s[window] + (scene.duration_s if start_s else 0.0)
        return replace(
            rollout,
            scene=scene,
            times_s=np.concatenate([[0.0], times_s]) if start_s else times_s,
            states={},
            nodes_m={
                body.name: np.concatenate([nodes[:1], nodes[window]])
                if start_s
                else nodes[window]
            },
        )

    def at_rest(self, rollout: Recording, name: str = "") -> Recording:
        """Return the rollout of a body, the first one by default, while the frame stands still."""
        return self.part(rollout, name or next(iter(self.scenes)), 0.0, self.still_s)

    def parts(self, rollout: Recording) -> Iterator[tuple[str, Recording]]:
        """Yield each body while the frame stands still, and while it moves with its speed."""
        for name in self.scenes:
            yield f"{name} at rest", self.at_rest(rollout, name)
            late = self.part(rollout, name, self.still_s + RAMP_S, np.inf)
            yield f"{name} at {self.speed_m_per_s:g} m/s", late

    def ratio(
        self, measure: Callable[[Recording], Measurement], what: str
    ) -> Callable[[Recording], Measurement]:
        """Return the measurement of the ratio to its law that is furthest from 1, over all bodies and phases."""

        def measured(rollout: Recording) -> Measurement:
            ratios, hints = {}, {}
            for name, part in self.parts(rollout):
                found = measure(part)
                ratios[name] = found.measured / found.expected
                hints[name] = found.hint
            worst = worst_ratio(ratios, what)
            name = next(one for one in ratios if ratios[one] is worst.measured)
            hint = "; ".join(filter(None, (hints[name], worst.hint)))
            return replace(worst, hint=hint)

        measured.__module__ = measure.__module__
        return measured

    def held_error(self, rollout: Recording) -> Measurement:
        """Measure the largest displacement [mm] of a clamped node relative to the frame."""
        errors: dict[str, float] = {}
        for name, scene in self.scenes.items():
            part = self.part(rollout, name, 0.0, np.inf)
            (nodes,) = part.nodes_m.values()
            (body,) = scene.deformables
            local = body.pose.to_body(nodes[0])
            for attachment in scene.attachments:
                depths_m = _depths_m(local, body, attachment.region)
                inside = depths_m < attachment.region.depth_m + PLACE_TOLERANCE_M
                moved = nodes[:, inside] - nodes[0, inside]
                # Nodes that are elsewhere at the start are not in the clamp.
                furthest_mm = largest_mm(moved) if inside.any() else np.inf
                errors[name] = max(errors.get(name, 0.0), furthest_mm)
        return furthest(errors)

    def clamp_excess(self, rollout: Recording) -> Measurement:
        """Measure how far beyond its clamp a node of a body is still while the frame stands still [mm]."""
        excesses: dict[str, float] = {}
        for name, scene in self.scenes.items():
            (nodes,) = self.at_rest(rollout, name).nodes_m.values()
            (body,) = scene.deformables
            (attachment,) = scene.attachments
            still = np.linalg.norm(nodes - nodes[0], axis=2).max(axis=0) < HELD_M
            local = body.pose.to_body(nodes[0, still])
            depths_m = _depths_m(local, body, attachment.region)
            deepest_m = float(depths_m.max(initial=0.0))
            excesses[name] = 1e3 * max(0.0, deepest_m - attachment.region.depth_m)
        return furthest(excesses)


def _depths_m(local_m: Any, body: Any, region: Region) -> Any:
    """Return the distance of points in the frame of a body from the side of a region [m]."""
    axis = "xyz".index(region.axis)
    along = local_m[:, axis] * (1.0 if region.side == "low" else -1.0)
    return along - _lowest_m(body, axis)


def _lowest_m(body: Any, axis: int) -> float:
    """Return the coordinate of the low side of a deformable body along an axis of its frame [m]."""
    if hasattr(body, "length_m"):
        return -0.5 * float(body.length_m)
    size = body.size_m if hasattr(body, "size_m") else body.shape.size_m
    return -0.5 * float(size[axis])
