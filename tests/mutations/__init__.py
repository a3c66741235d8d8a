"""Mutants: a backend with one planted fault each, which shows what the checks can catch.

    from gauge_envs.backends import backend
    from mutations import FAULTS, Mutant, first_failure

    fault = FAULTS["plane-level"]
    print(first_failure(Mutant(backend("mujoco"), fault)))

Most faults change the scene that the wrapped backend builds, or what its simulation returns, so that any backend can
have them. Faults that only an engine itself can have, such as a wrong inertia, are planted in MuJoCo's model.
"""

from mutations import (
    deformable_scenes,
    joint_scenes,
    mujoco_model,
    reports,
    rigid_scenes,
    stepping,
    worlds,
    wrenches,
)
from mutations.mutant import (
    FAILS_ITSELF,
    PUBLISHED,
    Fault,
    Mutant,
    Passed,
    first_failure,
    is_of_the_fault,
)

__all__ = [
    "FAILS_ITSELF",
    "FAULTS",
    "PUBLISHED",
    "Fault",
    "Mutant",
    "Passed",
    "first_failure",
    "is_of_the_fault",
]

FAULTS = {
    **rigid_scenes.FAULTS,
    **reports.FAULTS,
    **stepping.FAULTS,
    **wrenches.FAULTS,
    **mujoco_model.FAULTS,
    **joint_scenes.FAULTS,
    **deformable_scenes.FAULTS,
    **worlds.FAULTS,
}
"""Faults by id: those of rigid scenes first, those of deformable scenes last."""
