"""Text of the convergence of an experiment: what half the step and half the cell change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.pages.text import quantity_text
from gauge_envs.references.convergence import RefinedSetting, convergence_of

NAMES: dict[RefinedSetting, str] = {"timestep_s": "half step", "cell_m": "half cell"}


def convergence_rows(engine: str, variant: str) -> dict[str, dict[str, Any]]:
    """Return the measured convergence of a variant on an engine, JSON-ready, by the setting that was halved."""
    return {setting: row.model_dump() for setting, row in convergence_of(engine, variant).items()}


def convergence_text(rows: Mapping[str, Mapping[str, Any]], *, has_cells: bool, with_unit: bool = False) -> str:
    """Return what half the step and half the cell change, in one line.

    Args:
        rows: Rows of `convergence_rows`.
        has_cells: Whether the experiment has deformable bodies, whose cells can be halved.
        with_unit: Whether to add the root mean square and the maximum over frames in the unit of g(t).

    Example:
        >>> row = {"unit": "mm", "rms": 0.062, "max": 0.18, "share": 0.0034}
        >>> convergence_text({"timestep_s": row}, has_cells=True)
        'half step moves the trajectory by 0.34 % of the real scatter; half cell: not measured'
    """
    parts = []
    for setting, name in NAMES.items():
        if setting == "cell_m" and not has_cells:
            continue
        row = rows.get(setting)
        if row is None:
            parts.append(f"{name}: not measured")
        elif row["rms"] is None:
            parts.append(f"{name}: diverged")
        else:
            parts.append(f"{name} moves the trajectory by {_amount(row, with_unit=with_unit)}")
    return "; ".join(parts)


def _amount(row: Mapping[str, Any], *, with_unit: bool) -> str:
    """Return the share of the scatter; without a published scatter, the distance of the observed points."""
    if row["share"] is None:
        amount = f"{quantity_text(row['points_rms_mm'])} mm (rms of the observed points)"
    else:
        amount = f"{_percent(row['share'])} % of the real scatter"
    if not with_unit:
        return amount
    rms, largest = quantity_text(row["rms"]), quantity_text(row["max"])
    return f"{amount}, g(t) by {rms} {row['unit']} rms and {largest} {row['unit']} at most"


def _percent(share: float) -> str:
    """Return a share in percent with two digits; a share below 0.01 % as such."""
    percent = 100.0 * share
    return "less than 0.01" if percent < 0.01 else f"{percent:.0f}" if percent >= 99.5 else f"{percent:.2g}"
