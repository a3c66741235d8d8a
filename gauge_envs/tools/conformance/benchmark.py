"""Going back to a state in scenes of the benchmark. These checks are the last, since they take the longest."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.tools.conformance.continuation import (
    CONTINUATION,
    continuation_differences,
    continuation_measurement,
)
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Measurement

RIGID = {
    "SlopeContact-wood": 0.15,
    "NonsmoothContact-1-wood": 0.15,
    "SlopeSlider-2-wood": 0.3,
    "Turntable-1-wood": 0.6,
    "WallBreaking-wood": 0.1,
    "NewtonsCradle-metal": 0.3,
    "BouncingBall-rubber": 0.4,
    "Pendulum-metal": 0.3,
}
SOFT = {
    "TextileStretching-satin": 0.1,
    "FoamTwisting-soft": 0.05,
    "RopeWinding-rubber": 0.1,
}
"""Experiments and the time at which the state is saved [s]."""


def _benchmark_check(
    id: str, title: str, what: str, saved_s: Mapping[str, float]
) -> None:
    """Register the check that scenes of the benchmark continue bit for bit."""
    scene = f"{what} scenes of the benchmark, as far as the backend builds them: {', '.join(saved_s)}"
    measures = f"{CONTINUATION.measures}, the worst of all scenes"

    @replace(CONTINUATION, id=id, title=title, scene=scene, measures=measures)
    def measure(lab: Lab) -> Measurement:
        from gauge_envs.experiments.resolve import (
            load_experiment,
        )  # At use: most checks have no experiment.

        scenes = {name: load_experiment(name).scene for name in saved_s}
        chosen = [name for name, scene in scenes.items() if lab.backend.supports(scene)]
        found: dict[str, Measurement] = {}
        missing: tuple[str, ...] = ()
        for name in chosen or list(scenes)[:1]:
            before = round(180.0 * saved_s[name])
            try:
                found[name] = continuation_measurement(
                    continuation_differences(lab, scenes[name], before=before)
                )
            except (
                DeclinedError
            ) as declined:  # The given settings are not for this scene.
                missing = declined.missing
        if not found:
            raise DeclinedError(missing)
        worst = max(
            found, key=lambda name: np.nan_to_num(found[name].measured, nan=np.inf)
        )
        one = found[worst]
        return Measurement(
            measured=one.measured, hint=f"{worst}: {one.hint}" if one.hint else ""
        )


_benchmark_check(
    "restore-benchmark-rigid",
    "restore in rigid scenes of the benchmark",
    "rigid",
    RIGID,
)
_benchmark_check(
    "restore-benchmark-soft",
    "restore in deformable scenes of the benchmark",
    "deformable",
    SOFT,
)
