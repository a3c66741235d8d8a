"""Conformance of Newton: the laws of contact between shapes, wrenches and inertia."""

from __future__ import annotations

import pytest

pytest.importorskip("newton")

from gauge_envs.tools.conformance import Status, run_checks


def test_shapes_at_rest_and_on_slopes() -> None:
    results = list(run_checks("newton", only=["rest-*", "roll-*", "slide-plane"]))
    assert {one.check for one in results if one.status is not Status.PASS} == set()
    assert "roll-cylinder" in {one.check for one in results}


def test_wrenches_and_inertia() -> None:
    results = run_checks("newton", only=["wrench-*", "inertia-*", "swing-*", "restore-wrench", "restore-edge"])
    assert {one.check for one in results if one.status is not Status.PASS} == set()
