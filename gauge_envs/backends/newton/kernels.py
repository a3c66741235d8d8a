"""Warp kernels of the Newton backend; Warp compiles them, so they use Warp's types."""

from __future__ import annotations

import warp as wp


@wp.kernel(enable_backward=False)
def begin_drives(
    sent: wp.array2d[wp.float32],
    start: wp.array[wp.transform],
    velocity: wp.array[wp.spatial_vector],
    acceleration: wp.array[wp.spatial_vector],
    elapsed: wp.array[wp.int32],
):
    """Begin the new drives of rows of `Worlds.drive`; a last column is 1 for those that are new."""
    i = wp.tid()
    if sent[i, 19] == 0.0:
        return
    # Warp's quaternions are x, y, z, w.
    start[i] = wp.transform(
        wp.vec3(sent[i, 0], sent[i, 1], sent[i, 2]),
        wp.quat(sent[i, 4], sent[i, 5], sent[i, 6], sent[i, 3]),
    )
    v = wp.spatial_vector()
    a = wp.spatial_vector()
    for k in range(6):
        v[k] = sent[i, 7 + k]
        a[k] = sent[i, 13 + k]
    velocity[i] = v
    acceleration[i] = a
    elapsed[i] = 0


@wp.kernel
def prescribe(
    body: wp.array[wp.int32],
    start: wp.array[wp.transform],
    velocity: wp.array[wp.spatial_vector],
    acceleration: wp.array[wp.spatial_vector],
    elapsed: wp.array[wp.int32],
    steps_ahead: int,
    counts: int,
    timestep_s: float,
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
):
    """Write poses and velocities of uniformly accelerated driven bodies, some steps after their drive."""
    # Spatial vectors hold the linear part first.
    i = wp.tid()
    t = float(elapsed[i] + steps_ahead) * timestep_s
    elapsed[i] = elapsed[i] + counts
    displacement = t * velocity[i] + 0.5 * t * t * acceleration[i]
    rotation_vector = wp.spatial_bottom(displacement)
    angle = wp.length(rotation_vector)
    rotation = wp.quat_identity()
    if angle > 0.0:
        rotation = wp.quat_from_axis_angle(rotation_vector / angle, angle)
    position = wp.transform_get_translation(start[i]) + wp.spatial_top(displacement)
    body_q[body[i]] = wp.transform(
        position, rotation * wp.transform_get_rotation(start[i])
    )
    body_qd[body[i]] = velocity[i] + t * acceleration[i]


@wp.kernel
def bodies_to_joints(
    body: wp.array[wp.int32],
    coordinate: wp.array[wp.int32],
    freedom: wp.array[wp.int32],
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    joint_q: wp.array[float],
    joint_qd: wp.array[float],
):
    """Copy poses and velocities of bodies to the coordinates of their free joints."""
    i = wp.tid()
    for k in range(7):
        joint_q[coordinate[i] + k] = body_q[body[i]][k]
    for k in range(6):
        joint_qd[freedom[i] + k] = body_qd[body[i]][k]


@wp.kernel
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


@wp.kernel
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


@wp.kernel
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
    """Move particles to their positions on bodies before a step, with the velocity that leads to those after it."""
    i = wp.tid()
    here = wp.transform_point(body_q[body[i]], place[i])
    there = wp.transform_point(body_q_after[body[i]], place[i])
    particle_q[particle[i]] = here
    particle_qd[particle[i]] = wp.div(wp.sub(there, here), timestep_s)
    particle_qd_grad[particle[i]] = wp.skew(wp.spatial_bottom(body_qd_after[body[i]]))
