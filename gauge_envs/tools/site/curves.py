"""The curves of one experiment: of all configurations that ran, over the reference or without one."""

from collections.abc import Sequence

import numpy as np

from gauge_envs.pages.document import Heading, Paragraph, Tone
from gauge_envs.pages.html import Html, element, join, listed
from gauge_envs.pages.svg import CurvePanel, curve_panel
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.compare import (
    choose_yardstick,
    coordinate_words,
    is_aligned,
)
from gauge_envs.tools.site.model import Parts, Results, Site

MAX_PANELS = 6
"""Largest number of coordinates that are drawn."""

MIN_RANGE = 0.02
"""Smallest range of a panel, relative to the largest motion of the reference."""

MAX_SECONDS = 10.0
"""Longest time that is drawn [s]: in a longer one, swings of a second cannot be told apart."""

Recorded = Sequence[tuple[int, FloatArray, FloatArray, Sequence[str]]]
"""Configuration, times [s], g(t) of shape [sample_count, coordinate_count], and names of the coordinates."""


def curves(site: Site, unit: str, results: Results, band: Band | None) -> Parts:
    """Return the curves of all configurations that ran over the band, or without one."""
    recorded = [
        (index, *result.trajectory.arrays(), result.trajectory.coordinates)
        for index, result in results.items()
        if result.trajectory is not None
    ]
    if not recorded:
        return []
    end_s = max(float(times[-1]) for _, times, _, _ in recorded)
    shown_s = min(end_s, MAX_SECONDS)
    if band is None:
        panels, note = _plain_panels(site, unit, recorded, shown_s)
    else:
        panels, note = _band_panels(site, results, band, shown_s)
    notes = [note] if note else []
    if shown_s < end_s:
        notes.append(
            f"The first {shown_s:g} of {end_s:.3g} s are drawn; scores use all frames."
        )
    return [
        Heading("Curves" if band is None else "Curves over the reference"),
        _legend(site, [index for index, *_ in recorded], band),
        element(
            "div",
            *(element("figure", curve_panel(panel)) for panel in panels),
            class_="panels",
        ),
        *(Paragraph(note, Tone.NOTE) for note in notes),
    ]


def _legend(site: Site, indices: Sequence[int], band: Band | None) -> Html:
    entries = [site.links[index] for index in indices]
    if band is not None:
        means = {
            Kind.RECORDING: "real: one recorded trial",
            Kind.ANALYTIC: "closed form, not measured",
            Kind.NUMERICAL: "numerical solution, not measured",
        }
        unit = "u of the solution" if band.kind.is_solution else "sigma"
        mean = (
            "real mean"
            if band.trial_count is None
            else f"real mean of {band.trial_count} trials"
        )
        for color, kind, text in (
            ("--real", "swatch", means.get(band.kind, mean)),
            ("--band1", "swatch area", f"1 {unit}"),
            ("--band2", "swatch area", f"2 {unit}"),
        ):
            entries.append(
                join(
                    [
                        element("span", class_=kind, style=f"background:var({color})"),
                        text,
                    ]
                )
            )
        if (~band.measured & np.isfinite(band.mean).all(axis=1)).any():
            entries.append(join(["dotted: extrapolated, not measured"]))
    return listed(entries, class_="key")


def _band_panels(
    site: Site, results: Results, band: Band, end_s: float
) -> tuple[list[CurvePanel], str]:
    """Return the distance from the reference, and the coordinates with the largest share of it, with a note."""
    ran = {
        index: result
        for index, result in results.items()
        if result.trajectory is not None
        and len(result.trajectory.coordinates) == band.projection.shape[1]
    }
    against = choose_yardstick([*ran.values()], band, names=())
    deviations = {
        index: against.deviation(result, aligned=is_aligned(result))
        for index, result in ran.items()
    }
    shares = against.shares([*deviations.values()])
    mean, spread = against.band.mean, against.spread
    known = np.isfinite(mean).any(axis=1)
    spans = np.ptp(mean[known], axis=0)
    curves = [
        (site.line(i), site.labels[i], against.times_s, against.lengths(one))
        for i, one in deviations.items()
    ]
    distance = against.trial_distance(aligned=any(map(is_aligned, ran.values())))
    reach, text = against.lengths(spread), against.spread_words[0]
    if distance is not None:
        reach = np.full(len(mean), distance)
        text = "mean of the real trials from the mean of the others"
    curves.insert(0, (("var(--real)", True), text, against.times_s, reach))
    note = f"Dashed in the first panel: {text}. "
    panels = [
        CurvePanel(
            title=f"distance from {against.name} [{against.unit}]",
            curves=curves,
            end_s=end_s,
        )
    ]
    shown = {index: against.motion(result) for index, result in ran.items()}
    columns = sorted(np.argsort(-shares, kind="stable")[: MAX_PANELS - 1].tolist())
    panels += [
        CurvePanel(
            title=f"{coordinate_words(against.band.coordinates[column])} [{against.unit}]",
            curves=[
                (site.line(i), site.labels[i], times, values[:, column])
                for i, (times, values) in shown.items()
            ],
            end_s=end_s,
            times_s=against.times_s,
            mean=mean[:, column],
            sigma=spread[:, column],
            measured=against.band.measured,
            least_range=max(MIN_RANGE * float(spans.max()), 1e-9),
        )
        for column in columns
    ]
    if len(shares) > len(columns):
        note += f"{len(columns)} of {len(shares)} coordinates: those with the largest share of the squared distance."
    return panels, note.strip()


def _plain_panels(
    site: Site, unit: str, recorded: Recorded, end_s: float
) -> tuple[list[CurvePanel], str]:
    """Return panels without a reference: each coordinate, or of many the displacement from the start, with a note."""
    names, text = recorded[0][3], ""
    alike = [
        (i, times, values)
        for i, times, values, coordinates in recorded
        if len(coordinates) == len(names)
    ]
    if len(names) > MAX_PANELS:
        text = f"Root mean square over all {len(names)} coordinates of the change since the start."
        changes = (
            (i, times, np.sqrt(np.mean((x - x[0]) ** 2, axis=1, keepdims=True)))
            for i, times, x, _ in recorded
        )
        names, alike = ["change from the start, rms"], list(changes)
    panels = [
        CurvePanel(
            title=f"{name} [{unit}]",
            curves=[
                (site.line(i), site.labels[i], times, values[:, column])
                for i, times, values in alike
            ],
            end_s=end_s,
        )
        for column, name in enumerate(names)
    ]
    return panels, text
