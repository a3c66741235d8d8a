"""Causes that public threads have found are named first, in logs of a program of its own."""

import pytest

FIRST_WORDS = {
    "bulletphysics/bullet3#1562": "Dry friction: hip",
    "bulletphysics/bullet3#1916": "Damping: hip",
    "unitreerobotics/unitree_ros#130": "Armature: hip",
    "isaac-sim/IsaacLab#1586": "Joint order: hip follows neck",
    "zhaozijie2022/LocoWheeledLegged#2": "Action scale: hip 0.5",
    "strands-labs/robots#1187": "The policy sees base_angvel in the world frame",
    "isaac-sim/IsaacLab#5754": "The policy sees projected_gravity with a quaternion x y z w read as w x y z",
    "IsaacZH/himloco_lab#1": "The policy sees joint_pos with an offset of up to -0.3",
    "InternRobotics/HoST#2": "The target is the action added to the present pose",
}


@pytest.mark.slow
def test_the_answers_of_threads_are_named_first(tmp_path):
    from studies.found.logs.threads import first_lines

    lines = dict(first_lines(tmp_path))
    for thread, words in FIRST_WORDS.items():
        assert lines[thread].startswith(words), thread
