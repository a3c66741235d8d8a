"""Changes of a scene's parts, from which faults are made."""

from dataclasses import replace

from gauge_envs.scene import Motion


def change_bodies(change):
    """Return a fault that changes each body."""
    return lambda scene: replace(
        scene, bodies=tuple(change(one) for one in scene.bodies)
    )


def change_shapes(change, *motions):
    """Return a change of the shapes of bodies that move in one of some ways; of dynamic ones by default."""
    chosen = motions or (Motion.DYNAMIC,)
    return change_bodies(
        lambda one: (
            replace(one, shape=change(one.shape)) if one.motion in chosen else one
        )
    )


def change_contacts(*, friction=float, restitution=float):
    """Return a fault that changes the friction or the restitution of each contact."""

    def change(scene):
        contacts = (
            replace(
                one,
                friction=friction(one.friction),
                restitution=restitution(one.restitution),
            )
            for one in scene.contacts
        )
        return replace(scene, contacts=tuple(contacts))

    return change


def change_deformables(kind, **factors):
    """Return a fault that multiplies fields of each deformable body of a kind by factors."""

    def change(scene):
        changed = [
            replace(
                one,
                **{key: factor * getattr(one, key) for key, factor in factors.items()},
            )
            if isinstance(one, kind)
            else one
            for one in scene.deformables
        ]
        return replace(scene, deformables=tuple(changed))

    return change
