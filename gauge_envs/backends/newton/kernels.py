"""Warp kernels of the Newton backend; Warp compiles them, so they use Warp's types."""

from __future__ import annotations

import warp as wp


@wp.kernel(enable_backward=False)
def prescribe(
    body: wp.array[wp.int32],
    targets: wp.array2d[wp.float32],
    elapsed: wp.array[wp.int32],
    steps_ahead: int,
    counts: int,
    timestep_s: float,
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
):
    """Write poses and velocities of driven bodies, some steps after the start of their motion in rows of `drive`."""
    i = wp.tid()
    t = float(elapsed[i] + steps_ahead) * timestep_s
    elapsed[i] = elapsed[i] + counts
    velocity = wp.spatial_vector()
    acceleration = wp.spatial_vector()
    for k in range(6):
        velocity[k] = targets[i, 7 + k]
        acceleration[k] = targets[i, 13 + k]
    # Spatial vectors hold the linear part first.
    displacement = t * velocity + 0.5 * t * t * acceleration
    rotation_vector = wp.spatial_bottom(displacement)
    angle = wp.length(rotation_vector)
    rotation = wp.quat_identity()
    if angle > 0.0:
        rotation = wp.quat_from_axis_angle(rotation_vector / angle, angle)
    start_m = wp.vec3(targets[i, 0], targets[i, 1], targets[i, 2])
    # Warp's quaternions are x, y, z, w.
    start = wp.quat(targets[i, 4], targets[i, 5], targets[i, 6], targets[i, 3])
    position = start_m + wp.spatial_top(displacement)
    body_q[body[i]] = wp.transform(position, rotation * start)
    body_qd[body[i]] = velocity + t * acceleration


@wp.kernel(enable_backward=False)
def predict(
    timestep_s: float,
    velocity: wp.array[wp.vec3],
    inverse_mass: wp.array[float],
    last_velocity: wp.array[wp.vec3],
    displacement: wp.array[wp.vec3],
):
    """Write the displacement of each particle in a step with the acceleration of the last step."""
    i = wp.tid()
    if inverse_mass[i] > 0.0:
        displacement[i] = timestep_s * (2.0 * velocity[i] - last_velocity[i])
        last_velocity[i] = velocity[i]


@wp.kernel(enable_backward=False)
def hold(
    particle: wp.array[wp.int32],
    body: wp.array[wp.int32],
    place: wp.array[wp.vec3],
    body_q: wp.array[wp.transform],
    particle_q: wp.array[wp.vec3],
):
    """Move particles to their positions on bodies."""
    i = wp.tid()
    particle_q[particle[i]] = wp.transform_point(body_q[body[i]], place[i])


@wp.kernel(enable_backward=False)
def carry(
    particle: wp.array[wp.int32],
    body: wp.array[wp.int32],
    place: wp.array[wp.vec3],
    body_q: wp.array[wp.transform],
    body_q_after: wp.array[wp.transform],
    body_qd_after: wp.array[wp.spatial_vector],
    timestep_s: float,
    particle_q: wp.array[wp.vec3],
    particle_qd: wp.array[wp.vec3],
    particle_qd_grad: wp.array[wp.mat33],
):
    """Move particles to their positions on bodies before a step, with the velocity to the positions after it."""
    i = wp.tid()
    here = wp.transform_point(body_q[body[i]], place[i])
    there = wp.transform_point(body_q_after[body[i]], place[i])
    particle_q[particle[i]] = here
    particle_qd[particle[i]] = wp.div(wp.sub(there, here), timestep_s)
    particle_qd_grad[particle[i]] = wp.skew(wp.spatial_bottom(body_qd_after[body[i]]))
