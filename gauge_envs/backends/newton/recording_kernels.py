"""Warp kernels that score and judge recorded worlds; Warp compiles them, so they use Warp's types."""

from __future__ import annotations

import warp as wp


@wp.kernel(enable_backward=False)
def project(
    positions_m: wp.array4d[wp.float64],
    row: wp.array[wp.int32],
    projection: wp.array2d[wp.float64],
    sample_count: wp.array[wp.int32],
    last: wp.array[wp.int32],
    projected: wp.array3d[wp.float64],
):
    """Write band coordinates of each sample and world, and lower `last` to the sample before the first missing one."""
    s, n = wp.tid()
    missing = s >= sample_count[n]
    for c in range(projection.shape[0]):
        value = wp.float64(0.0)
        for b in range(row.shape[0]):
            for k in range(3):
                value += projection[c, 3 * b + k] * (
                    wp.float64(1e3) * positions_m[s, n, row[b], k]
                )
        projected[s, n, c] = value
        missing = missing or wp.isnan(value)
    if missing:
        wp.atomic_min(last, n, wp.max(s - 1, 0))


@wp.kernel(enable_backward=False)
def compare(
    projected: wp.array3d[wp.float64],
    mean: wp.array2d[wp.float64],
    known: wp.array2d[wp.float64],
    samples_per_frame: int,
    sample_count: wp.array[wp.int32],
    squares: wp.array[wp.float64],
):
    """Write the squared distance of each world from a band at its frames; NaN where a known frame is missing."""
    n = wp.tid()
    total = wp.float64(0.0)
    for t in range(mean.shape[0]):
        for c in range(mean.shape[1]):
            if known[t, c] > wp.float64(0.0):
                apart = projected[t * samples_per_frame, n, c] - mean[t, c]
                if t * samples_per_frame >= sample_count[n]:
                    apart = wp.float64(wp.nan)
                total += apart * apart
    squares[n] = total


@wp.kernel(enable_backward=False)
def align(
    projected: wp.array3d[wp.float64],
    mean: wp.array2d[wp.float64],
    known: wp.array2d[wp.float64],
    samples_per_frame: int,
    last_known: int,
    shift_limit: int,
    last: wp.array[wp.int32],
    shifts: wp.array[wp.float64],
    squares: wp.array[wp.float64],
):
    """Write the time shift [samples] of each world that minimises its squared distance from a band, and that distance.

    Between two whole shifts the distance is a parabola, whose minimum is exact. A world is
    held at its first and last sample.
    """
    n = wp.tid()
    zero = wp.float64(0.0)
    end = last[n]
    least = -wp.clamp(end - last_known, 0, shift_limit)
    best = zero
    for t in range(mean.shape[0]):
        for c in range(mean.shape[1]):
            apart = (
                projected[wp.clamp(t * samples_per_frame, 0, end), n, c] - mean[t, c]
            ) * known[t, c]
            best += apart * apart
    found = zero
    # From the smallest shift on, so that of equally good shifts the smallest is kept.
    for first in range(shift_limit):
        for side in range(2):
            sign = 1 - 2 * side
            here_here = zero
            here_change = zero
            change_change = zero
            for t in range(mean.shape[0]):
                one = wp.clamp(t * samples_per_frame - sign * first, 0, end)
                other = wp.clamp(t * samples_per_frame - sign * (first + 1), 0, end)
                for c in range(mean.shape[1]):
                    here = (projected[one, n, c] - mean[t, c]) * known[t, c]
                    change = (projected[other, n, c] - mean[t, c]) * known[t, c] - here
                    here_here += here * here
                    here_change += here * change
                    change_change += change * change
            share = zero
            if change_change > zero:
                share = wp.clamp(-here_change / change_change, zero, wp.float64(1.0))
            distance = here_here + share * (
                wp.float64(2.0) * here_change + share * change_change
            )
            if distance < best and (sign > 0 or least <= -(first + 1)):
                best = distance
                found = wp.float64(sign) * (wp.float64(first) + share)
    shifts[n] = found
    squares[n] = best


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
    """Lower `first` to the first frame in which a world may be out of bounds; see `RecordingKernels.suspects`.

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
                    within = within and wp.isfinite(
                        positions_m[before * samples_per_frame + 1 + s, n, b, k]
                    )
    within = within and (energy <= energies_j[n] * (wp.float64(1.0) - wp.float64(1e-9)))
    if not within:
        wp.atomic_min(first, n, frame)
