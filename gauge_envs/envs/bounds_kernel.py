"""Warp kernel of `rollout`; Warp compiles it, so it uses Warp's types."""

from __future__ import annotations

import warp as wp


@wp.kernel(enable_backward=False)
def find_suspects(
    states: wp.array4d[wp.float64],
    positions_m: wp.array4d[wp.float64],
    masses_kg: wp.array2d[wp.float64],
    distances_m: wp.array[wp.float64],
    speeds_m_per_s: wp.array[wp.float64],
    energies_j: wp.array[wp.float64],
    samples_per_frame: int,
    later: int,
    first: wp.array[wp.int32],
):
    """Lower `first` to the first frame in which a world may be out of bounds; see `RigidBoundsOfWorlds.suspects`.

    In frames from `later` on, a sample that is not finite counts too.
    """
    before, n = wp.tid()
    frame = before + 1
    within = bool(True)
    energy = wp.float64(0.0)
    # A comparison with NaN is false, so that each bound also catches what is not a number.
    for b in range(states.shape[2]):
        square = wp.float64(0.0)
        for k in range(3):
            speed = states[frame, n, b, 7 + k]
            square += speed * speed
            within = within and (wp.abs(states[frame, n, b, k]) <= distances_m[n])
            within = within and (wp.abs(speed) <= speeds_m_per_s[n])
            within = within and wp.isfinite(states[frame, n, b, 10 + k])
        for k in range(4):
            within = within and (wp.abs(states[frame, n, b, 3 + k]) <= wp.float64(2.0))
        energy += wp.float64(0.5) * masses_kg[n, b] * square
        if frame >= later:
            for s in range(samples_per_frame):
                for k in range(3):
                    within = within and wp.isfinite(positions_m[before * samples_per_frame + 1 + s, n, b, k])
    within = within and (energy <= energies_j[n] * (wp.float64(1.0) - wp.float64(1e-9)))
    if not within:
        wp.atomic_min(first, n, frame)
