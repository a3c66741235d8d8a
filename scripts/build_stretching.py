"""Combine the markers of TextileStretching with a membrane at rest, which is independent of the engines.

python -m scripts.build_stretching reads `scoring/models/TextileStretching-*` as `build_models` wrote them, of engines
alone, and writes them again with the markers of the membrane (`scripts/membrane.py`) and the engines combined, as two
families. Before the tip touches the cloth, its weight sets it swinging in its plane: there, the engines stand, and the
membrane only checks them. g(t) is left as it was.
"""

from __future__ import annotations

import io

import numpy as np

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.files import write_whole
from gauge_envs.references.models import (
    STRIDE,
    ModelSidecar,
    interpolated,
    packed,
    unpacked,
)
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.build_models import MOTION_SHARE, POINT_QUANTUM_MM
from scripts.extrapolation import anchored, combined, known_frames, rms
from scripts.generated import SCORING
from scripts.membrane import probe_points_m

FABRICS = ("rayon", "satin", "uniform", "nylon", "oxford", "leather")


def main() -> None:
    """Write the files of all fabrics."""
    for fabric in FABRICS:
        name = f"TextileStretching-{fabric}"
        file = SCORING / "models" / f"{name}.npz"
        sidecar = ModelSidecar.model_validate_json(
            file.with_suffix(".json").read_text(encoding="utf-8")
        )
        with np.load(file) as archive:
            arrays = {key: archive[key] for key in archive.files}
        count = sidecar.point_frames
        assert count is not None
        engines_mm = unpacked(arrays["points"], POINT_QUANTUM_MM)
        engines_u_mm = np.repeat(
            interpolated(arrays["points_uncertainty"], count), 3, axis=1
        )
        scene = load_experiment(name).scene
        assert scene.markers is not None
        places_m, parts, touches = probe_points_m(
            scene,
            np.arange(count) / FRAME_RATE_HZ,
            np.asarray(scene.markers.positions_m),
        )
        membrane_mm = 1e3 * places_m.reshape(count, -1)
        open_mm = 1e3 * np.sqrt(sum(np.square(part) for part in parts))
        # As of an engine: one number for each marker.
        open_mm = np.sqrt(np.square(open_mm).mean(axis=2)).repeat(3, axis=1)
        each = [(engines_mm, engines_u_mm), (membrane_mm, open_mm)]
        mean_mm, u_mm, _ = combined(each)
        first_mm, first_u_mm, _ = anchored(each)
        mean_mm[:touches], u_mm[:touches] = first_mm[:touches], first_u_mm[:touches]
        u_mm = np.sqrt(np.square(u_mm).reshape(count, -1, 3).mean(axis=2))
        limit_mm = MOTION_SHARE * rms(mean_mm - mean_mm[0])
        point_count, point_gap = known_frames(np.sqrt(3.0) * u_mm, limit_mm)
        arrays["points"] = packed(mean_mm[:point_count], POINT_QUANTUM_MM)
        arrays["points_uncertainty"] = u_mm[:point_count:STRIDE].astype(np.float16)
        content = io.BytesIO()
        np.savez_compressed(content, **arrays)
        changed = sidecar.model_copy(
            update={
                "point_frames": max(point_count, 1),
                "point_gap": point_gap,
                "point_solver": "a membrane at rest by finite elements",
            }
        )
        write_whole(file, content.getvalue())
        write_whole(
            file.with_suffix(".json"),
            (changed.model_dump_json(indent=1) + "\n").encode(),
        )
        print(
            f"{name}: {rms(membrane_mm - engines_mm) / np.sqrt(engines_mm.shape[1] / 3):.3f} mm apart, "
            f"frames {point_count}, gap {point_gap}",
            flush=True,
        )


if __name__ == "__main__":
    main()
