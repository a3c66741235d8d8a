"""Curves of an experiment over the real band, as panels of a page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.html import Html, element, join, listed
from gauge_envs.pages.svg import CurvePanel, curve_panel
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare import ExperimentComparison
from gauge_envs.tools.site.model import Site, first_results

FloatArray = NDArray[np.float64]

MOST_PANELS = 6
"""Largest number of coordinates that are drawn."""

MOST_SECONDS = 10.0
"""Longest time that is drawn [s]: in a longer one, swings of a second cannot be told apart."""

NOTHING: FloatArray = np.zeros(0)

Recorded = Sequence[tuple[int, FloatArray, FloatArray, Sequence[str]]]
"""Configuration, times [s], g(t) of shape [sample_count, coordinate_count], and names of the coordinates."""


def curve_section(site: Site, one: ExperimentComparison, band: Band | None) -> list[Part]:
    """Return the curves of all configurations that ran over the band, or without one."""
    recorded = [
        (index, *result.trajectory.arrays(), result.trajectory.coordinates)
        for index, result in first_results(one).items()
        if result.trajectory is not None
    ]
    if not recorded:
        return []
    end_s = max(float(times[-1]) for _, times, _, _ in recorded)
    shown_s = min(end_s, MOST_SECONDS)
    if band is None:
        panels, note = _plain_panels(site, one.unit, recorded, shown_s)
    else:
        panels, note = _band_panels(site, one.unit, recorded, band, shown_s)
    notes = [note] if note else []
    if shown_s < end_s:
        notes.append(f"The first {shown_s:g} of {end_s:.3g} s are drawn; scores use all frames.")
    return [
        Heading("Curves" if band is None else "Curves over the reference"),
        _legend(site, [index for index, *_ in recorded], band),
        element("div", *(element("figure", curve_panel(panel)) for panel in panels), class_="panels"),
        *(Paragraph(note, Tone.NOTE) for note in notes),
    ]


def mean_text(band: Band) -> str:
    """Return what the mean of a band is."""
    if band.grade is BandGrade.RECORDING:
        return "real: one recorded trial"
    if band.grade is BandGrade.LAW:
        return "law"
    return "real mean" if band.trial_count is None else f"real mean of {band.trial_count} trials"


def _legend(site: Site, indices: Sequence[int], band: Band | None) -> Html:
    entries = [site.links[index] for index in indices]
    if band is not None:
        for color, kind, text in (
            ("--real", "swatch", mean_text(band)),
            ("--band1", "swatch area", "1 sigma"),
            ("--band2", "swatch area", "2 sigma"),
        ):
            entries.append(join([element("span", class_=kind, style=f"background:var({color})"), text]))
        if (~band.measured & np.isfinite(band.mean).all(axis=1)).any():
            entries.append(join(["dotted: extrapolated, not measured"]))
    return listed(entries, class_="key")


def _band_panels(site: Site, unit: str, recorded: Recorded, band: Band, end_s: float) -> tuple[list[CurvePanel], str]:
    """Return the panels of the coordinates with the largest real motion, and a note if others are left out."""
    projected = [
        (index, times, band.project(values))
        for index, times, values, _ in recorded
        if values.shape[1] == band.projection.shape[1]
    ]
    spans = [float(np.ptp(column[np.isfinite(column)])) if np.isfinite(column).any() else 0.0 for column in band.mean.T]
    chosen = sorted(np.argsort(spans)[::-1][:MOST_PANELS].tolist())
    panels = [
        CurvePanel(
            title=f"{band.coordinates[column]} [{unit}]",
            curves=[(site.color(i), site.labels[i], times, values[:, column]) for i, times, values in projected],
            times_s=np.arange(len(band.mean)) / FRAME_RATE_HZ,
            mean=band.mean[:, column],
            sigma=band.sigma[:, column],
            measured=band.measured,
            end_s=end_s,
        )
        for column in chosen
    ]
    count = len(band.coordinates)
    left_out = f"{len(panels)} of {count} coordinates: those in which the real motion is largest."
    return panels, left_out if count > len(panels) else ""


def _plain_panels(site: Site, unit: str, recorded: Recorded, end_s: float) -> tuple[list[CurvePanel], str]:
    """Return panels without a reference: each coordinate, or of many the displacement from the start, with a note."""
    names = recorded[0][3]
    series: dict[str, list[tuple[str, str, FloatArray, FloatArray]]] = {}
    text = ""
    if len(names) <= MOST_PANELS:
        alike = [entry for entry in recorded if len(entry[3]) == len(names)]
        for number, name in enumerate(names):
            curves = [(site.color(i), site.labels[i], times, values[:, number]) for i, times, values, _ in alike]
            series[f"{name} [{unit}]"] = curves
    else:
        curves = [(site.color(i), site.labels[i], times, _displacement(values)) for i, times, values, _ in recorded]
        series[f"change from the start, rms [{unit}]"] = curves
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
