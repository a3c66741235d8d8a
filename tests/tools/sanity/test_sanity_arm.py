"""An arm on a fixed base: mistakes of people are found and named."""

import pytest
from arm_faults import LATER, MISTAKES, good_xml, read

from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS
from gauge_envs.tools.sanity.stacks import dialect
from gauge_envs.tools.sanity.target_checks import target_rows


def flags_of(configuration):
    rows = target_rows(configuration, dialect("mjcf"), ["gravity", *ROBOT_IDS])
    return {row.phenomenon: row for row in rows if row.is_flag}


def test_a_good_arm_has_no_flag_and_its_rows_are_measured():
    configuration = read(good_xml())
    assert flags_of(configuration) == {}
    rows = target_rows(configuration, dialect("mjcf"), ROBOT_IDS)
    assert [row.phenomenon for row in rows] == list(ROBOT_IDS)
    assert all(row.remark for row in rows if row.verdict is Verdict.DECLINED)
    measured = {
        row.phenomenon.removeprefix("robot-")
        for row in rows
        if row.verdict is not Verdict.DECLINED
    }
    assert measured >= {
        *("holds", "saturation", "overlap", "energy", "torque", "damping"),
        *("frictionloss", "armature", "rotor", "servo", "stiffness", "lag", "sag"),
    }


@pytest.mark.parametrize("name", [*MISTAKES, *LATER])
def test_a_mistake_is_found_and_named(name):
    change, row = (MISTAKES | LATER)[name]
    flags = flags_of(read(change(good_xml())))
    assert row in flags, sorted(flags)
    assert flags[row].consequence
