"""Rows on robots: a right quadruped has no flag, and each row finds the mistake that is planted for it."""

import pytest
from robot_faults import FAULTS, faulty_xml, good_xml

from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.rows import ROWS


@pytest.fixture
def rows_of(tmp_path):
    """Return the rows of a model by name."""

    def rows(xml, *names):
        file = tmp_path / "robot.xml"
        file.write_text(xml)
        report = check(str(file), only=names, explain=False)
        return {row.phenomenon: row for row in report.rows}

    return rows


def test_every_row_has_limits_and_a_planted_mistake():
    assert set(ROWS) == set(facts("robot_rows"))
    assert set(ROWS) <= set(FAULTS) <= set(ROBOT_IDS)


def test_a_right_quadruped_has_no_flag(rows_of):
    rows = rows_of(good_xml(), "robot-*", "floor-tilt")
    assert [name for name, row in rows.items() if row.verdict.is_off] == []
    assert {name for name, row in rows.items() if not row.applies} == {"robot-coupling"}


@pytest.mark.parametrize("name", FAULTS)
def test_a_mistake_is_flagged_with_its_size_beside_the_limit(name, rows_of):
    row = rows_of(faulty_xml(name), name)[name]
    assert row.is_flag, row
    assert row.reality.limits and row.consequence
    assert any(part.verdict.is_off for part in row.parts)
