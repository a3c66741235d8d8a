"""Curves of an experiment over the real band, as panels of a page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gauge_envs.pages.html import Html, element, join
from gauge_envs.pages.svg import CurvePanel, curve_panel
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare.comparison import ExperimentComparison
from gauge_envs.tools.site.model import Site, first_result

FloatArray = NDArray[np.float64]

MOST_PANELS = 6
"""Largest number of coordinates that are drawn."""

MOST_SECONDS = 10.0
"""Longest time that is drawn [s]: in a longer one, swings of a second cannot be told apart."""

NOTHING: FloatArray = np.zeros(0)

Curves = list[tuple[str, str, FloatArray, FloatArray]]


def curve_section(site: Site, one: ExperimentComparison, band: Band | None) -> Html:
    """Return the curves of all configurations that ran over the band, or without one."""
    recorded = [
        (index, *result.trajectory.arrays(), result.trajectory.coordinates)
        for index, cell in enumerate(one.cells)
        if (result := first_result(cell)) is not None and result.trajectory is not None
    ]
    if not recorded:
        return Html("")
    end_s = max(float(times[-1]) for _, times, _, _ in recorded)
    shown_s = min(end_s, MOST_SECONDS)
    notes = []
    if band is not None:
        panels, count = _band_panels(site, one.unit, recorded, band, shown_s)
        if count > len(panels):
            notes.append(f"{len(panels)} of {count} coordinates: those in which the real motion is largest.")
    else:
        panels, text = _plain_panels(site, one.unit, recorded, shown_s)
        notes += [text] if text else []
    if shown_s < end_s:
        notes.append(f"The first {shown_s:g} of {end_s:.3g} s are drawn; scores use all frames.")
    return join(
        [
            element("h2", "Curves" if band is None else "Curves over the reference"),
            _legend(site, [index for index, *_ in recorded], band),
            element("div", *(element("figure", curve_panel(panel)) for panel in panels), class_="panels"),
            *(element("p", note, class_="small") for note in notes),
        ]
    )


def mean_text(band: Band) -> str:
    """Return what the mean of a band is."""
    if band.grade is BandGrade.RECORDING:
        return "real: one recorded trial"
    if band.grade is BandGrade.LAW:
        return "law"
    return "real mean" if band.trial_count is None else f"real mean of {band.trial_count} trials"


def _legend(site: Site, indices: Sequence[int], band: Band | None) -> Html:
    entries = [element("li", site.configuration_link(index)) for index in indices]
    if band is not None:
        for color, kind, text in (
            ("--real", "swatch", mean_text(band)),
            ("--band1", "swatch area", "1 sigma"),
            ("--band2", "swatch area", "2 sigma"),
        ):
            swatch = element("span", Html(""), class_=kind, style=f"background:var({color})")
            entries.append(element("li", swatch, text))
        if (~band.measured & np.isfinite(band.mean).all(axis=1)).any():
            entries.append(element("li", "dotted: extrapolated, not measured"))
    return element("ul", *entries, class_="key")


def _band_panels(
    site: Site,
    unit: str,
    recorded: Sequence[tuple[int, FloatArray, FloatArray, Sequence[str]]],
    band: Band,
    end_s: float,
) -> tuple[list[CurvePanel], int]:
    """Return the panels of the coordinates with the largest real motion, and the number of all coordinates."""
    width = band.projection.shape[1]
    projected = [
        (index, times, band.project(values)) for index, times, values, _ in recorded if values.shape[1] == width
    ]
    spans = [float(np.ptp(column[np.isfinite(column)])) if np.isfinite(column).any() else 0.0 for column in band.mean.T]
    chosen = sorted(np.argsort(spans)[::-1][:MOST_PANELS].tolist())
    times_s = np.arange(len(band.mean)) / FRAME_RATE_HZ
    panels = [
        CurvePanel(
            title=f"{band.coordinates[column]} [{unit}]",
            curves=[
                (site.color(index), site.labels[index], times, values[:, column]) for index, times, values in projected
            ],
            times_s=times_s,
            mean=band.mean[:, column],
            sigma=band.sigma[:, column],
            measured=band.measured,
            end_s=end_s,
        )
        for column in chosen
    ]
    return panels, len(band.coordinates)


def _plain_panels(
    site: Site,
    unit: str,
    recorded: Sequence[tuple[int, FloatArray, FloatArray, Sequence[str]]],
    end_s: float,
) -> tuple[list[CurvePanel], str]:
    """Return panels without a reference: each coordinate, or of many the displacement from the start."""
    names = recorded[0][3]
    if len(names) <= MOST_PANELS:
        columns = {f"{name} [{unit}]": number for number, name in enumerate(names)}
        series: dict[str, Curves] = {
            title: [(site.color(i), site.labels[i], t, v[:, n]) for i, t, v, own in recorded if len(own) == len(names)]
            for title, n in columns.items()
        }
        text = ""
    else:
        title = f"change from the start, rms [{unit}]"
        series = {title: [(site.color(i), site.labels[i], t, _displacement(v)) for i, t, v, _ in recorded]}
        text = f"Root mean square over all {len(names)} coordinates of the change since the start."
    empty = np.zeros(0, dtype=bool)
    panels = [
        CurvePanel(
            title=title, curves=curves, times_s=NOTHING, mean=NOTHING, sigma=NOTHING, measured=empty, end_s=end_s
        )
        for title, curves in series.items()
    ]
    return panels, text


def _displacement(values: FloatArray) -> FloatArray:
    change: FloatArray = np.sqrt(np.mean((values - values[0]) ** 2, axis=1))
    return change
