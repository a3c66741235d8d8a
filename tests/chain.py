"""A chain of equal balls that collide one pair after another: an independent check of Newton's cradle."""

from __future__ import annotations

import numpy as np


def event_driven_chain(restitution, *, ball_count=5, closing=1e-12):
    """Return the speeds of the balls, over that of the incoming one, after all collisions, shape [ball_count].

    The balls touch and the first one arrives at speed 1. The leftmost pair that closes collides next: a pair moves on
    with its mean speed and restitution times its half difference. Balls that close no faster than `closing` are done.
    """
    speeds = np.zeros(ball_count)
    speeds[0] = 1.0
    while (pairs := np.flatnonzero(speeds[:-1] - speeds[1:] > closing)).size:
        left, right = pairs[0], pairs[0] + 1
        mean = 0.5 * (speeds[left] + speeds[right])
        half = 0.5 * restitution * (speeds[left] - speeds[right])
        speeds[left], speeds[right] = mean - half, mean + half
    return speeds


def simultaneous_impact(restitution, *, ball_count=5):
    """Return the speeds after one impact in which the resting balls move on as one body, shape [ball_count].

    All contacts are closed at once. Only the first one rebounds, because the others have no approaching speed: n - 1
    balls leave at u and the first at u - e, with n u - e = 1 by the conservation of momentum.
    """
    together = (1.0 + restitution) / ball_count
    return np.array([together - restitution, *[together] * (ball_count - 1)])
