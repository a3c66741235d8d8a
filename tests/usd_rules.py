"""Rules of USD that every layer must follow."""

from __future__ import annotations

import pytest
from pxr import Usd


def usd_faults(stage: Usd.Stage) -> list[str]:
    """Return what every validator that this usd-core ships finds wrong."""
    validation = pytest.importorskip("pxr.UsdValidation")
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    found = validation.ValidationContext(validators).Validate(stage)
    return [error.GetErrorAsString() for error in found]
