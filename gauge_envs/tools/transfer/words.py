"""What policies keep of the reward that their training promised, and ranges, in words and figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.document import Document, Paragraph, Part
from gauge_envs.pages.figures import OURS, REAL, new_figure, tidy_axis
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import counted
from gauge_envs.tools.transfer.estimates import Estimate
from gauge_envs.tools.transfer.ranges import Justified
from gauge_envs.tools.transfer.settings_replay import SettingsReport
from gauge_envs.tools.transfer.stack_files import evidence
from gauge_envs.tools.transfer.transfer import (
    FALL_SHARE,
    TransferReport,
    WorldTransfer,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SUCCESSES = ("held", "reached")
"""Endings of episodes in which the task succeeded."""


def transfer_verdict(report: TransferReport) -> str:
    """Return the result in a few sentences, first of the training: what it gets wrong, others cannot mend."""
    sentences = [_training_note(report)]
    kept = f"Keeps {_percent(report.kept)} of the promised reward"
    fall, count = report.first_fall, len(report.distinct)
    if fall is None:
        kept += f"; falls below {100 * FALL_SHARE:.0f} % of it in none of {counted(count, 'world')}."
    else:
        kept += f"; first falls with {fall.world.name}, where it keeps {_percent(fall.kept)}."
    if report.kept.value > 1.0 / FALL_SHARE:
        kept += " More than all: the training promises too little."
    sentences.append(kept)
    if fall is not None:
        number = sum(row.falls for row in report.distinct)
        sentences.append(f"It falls in {number} of {counted(count, 'world')}.")
    above = max((report.training, *report.others), key=lambda row: row.largest_ratio)
    if above.largest_ratio > 1.0:
        sentences.append(
            f"The largest ratio is {above.largest_ratio:.3f}, in {above.world.name}: above 1 the engine pays more than "
            "the law, or the task's stated tolerance is used."
        )
    if report.repeats:
        sentences.append(
            f"{len(report.repeats)} of {counted(len(report.others), 'world')} repeat another's rewards to the last "
            "digit and count once."
        )
    sentences.append(_interval_note(report))
    if report.left_out:
        sentences.append(f"Worlds left out: {len(report.left_out)}.")
    return " ".join(sentences)


def _training_note(report: TransferReport) -> str:
    """Return what the policies reach where they were trained, and how they fail there."""
    trained = report.training
    failures = {
        ending: number
        for ending, number in trained.endings.items()
        if ending not in SUCCESSES
    }
    if not failures:
        return f"In training it reached {trained.ratio:.2f} of what the law allows."
    total = sum(trained.endings.values())
    endings = ", ".join(f"{number} {ending}" for ending, number in failures.items())
    return (
        f"The training itself fails at {trained.ratio:.2f} of what the law allows: {endings} of "
        f"{counted(total, 'episode')}. Its reward is no promise of a success."
    )


def _interval_note(report: TransferReport) -> str:
    policies, starts = len(report.policies), report.starts
    if policies * starts == 1:
        return "One policy from one start has no interval."
    if policies == 1:
        return f"The interval is over {starts} starts of one policy; other training seeds can differ by more."
    return f"The interval is over {policies} policies and {counted(starts, 'start')}."


def _percent(value: Estimate) -> str:
    text = f"{100 * value.value:.0f} %"
    if value.low is None or value.high is None:
        return text
    return f"{text} [{100 * value.low:.0f}, {100 * value.high:.0f}]"


def transfer_document(report: TransferReport) -> Document:
    """Return one row for each world, the training first, and the result; the last JSON row is of the whole."""
    worlds, verdict = [report.training, *report.others], transfer_verdict(report)
    table = Table(
        columns=(
            Column("world.name", "world"),
            Column(
                "reward.value", "reward", lambda value: f"{value:.2f}", is_number=True
            ),
            Column("kept", "kept", _percent, is_number=True),
            Column(
                "allowed", "law allows", lambda value: f"{value:.3f}", is_number=True
            ),
            Column("ratio", "of the law", lambda value: f"{value:.3f}", is_number=True),
            Column(
                "z", "z", lambda value: f"{value:+.1f}", is_number=True, wide_only=True
            ),
            Column(
                "endings",
                "episodes",
                lambda value: ", ".join(f"{n} {e}" for e, n in value.items()),
            ),
            Column(
                "falls",
                "",
                lambda value: "falls" if value else "",
                style=lambda value: "red" if value else "",
            ),
            Column(
                "world.source", "source of sigma", place=Place.BELOW, wide_only=True
            ),
        ),
        rows=[_with_repeats(row, report) for row in (worlds[0], *report.distinct)],
    )
    whole = {
        "kind": "verdict",
        "task": report.task,
        "policies": report.policies,
        "starts": report.starts,
        "kept": dataclasses.asdict(report.kept),
        "first_fall": None
        if report.first_fall is None
        else report.first_fall.world.name,
        "left_out": report.left_out,
        "repeats": report.repeats,
        "verdict": verdict,
    }
    parts = (table, Paragraph(""), Paragraph(verdict))
    return Document(parts=parts, rows=[*map(_world_row, worlds), whole])


def _with_repeats(row: WorldTransfer, report: TransferReport) -> WorldTransfer:
    """Return a row whose name has the worlds that repeat its rewards."""
    same = [name for name, first in report.repeats.items() if first == row.world.name]
    if not same:
        return row
    name = "; ".join([row.world.name, *_without_prefix(same, row.world.name)])
    return dataclasses.replace(row, world=dataclasses.replace(row.world, name=name))


def _without_prefix(names: Sequence[str], first: str) -> list[str]:
    """Return names without the engine that they share with the first one."""
    return [f"same {name.removeprefix(first).lstrip(', ')}" for name in names]


def _world_row(row: WorldTransfer) -> dict[str, Any]:
    values = dataclasses.asdict(row)
    world = values.pop("world")
    return {"kind": world.pop("kind"), "world": world.pop("name"), **world, **values}


# --- settings ---


def settings_verdict(report: SettingsReport) -> str:
    """Return the result in a few sentences."""
    test, sentences = report.test, []
    change = f"The reward changes by {_interval(test.change)} from the same seeds."
    if test.kept is None:
        sentences.append(
            f"The training earns no positive reward, so no share is kept. {change}"
        )
    else:
        sentences.append(
            f"Keeps {_percent(test.kept)} of the reward of the training's settings. {change}"
        )
    if report.falls:
        sentences.append("It falls: the whole interval says so.")
    if test.success is None:
        sentences.append("The environment states no success (info['is_success']).")
    count = len(report.policies) * report.seeds
    sentences.append(
        f"{counted(len(report.policies), 'policy')}, {counted(count, 'episode')} with each of both settings."
    )
    return " ".join(sentences)


def _interval(value: Estimate) -> str:
    if value.low is None or value.high is None:
        return f"{value.value:+.4g}"
    return f"{value.value:+.4g} [{value.low:+.4g}, {value.high:+.4g}]"


def settings_document(report: SettingsReport) -> Document:
    """Return a row for each set of settings, and the result; the JSON row is the report."""
    verdict = settings_verdict(report)
    rows = [
        {"name": "training", "row": report.training},
        {"name": "test", "row": report.test},
    ]

    def assigned(settings: Mapping[str, str]) -> str:
        return ", ".join(f"{key}={text}" for key, text in settings.items())

    def percent(value: Estimate | None) -> str:
        return "-" if value is None else _percent(value)

    table = Table(
        columns=(
            Column("name", "settings"),
            Column("row.reward", "reward", _interval, is_number=True),
            Column("row.kept", "kept", percent, is_number=True),
            Column("row.success", "success", percent, is_number=True),
            Column("row.full_length", "full length", lambda value: f"{100 * value:.0f} %", is_number=True),
            Column("row.settings", "changed", assigned, place=Place.BELOW),
        ),
        rows=rows,
    )  # fmt: skip
    parts = (table, Paragraph(""), Paragraph(verdict))
    return Document(
        parts=parts, rows=[dataclasses.asdict(report) | {"verdict": verdict}]
    )


# --- ranges ---


def ranges_document(found: Justified) -> Document:
    """Return a row for each range, and one for each constant without; the JSON rows are the same."""
    ranges = Table(
        columns=(
            Column("name", "constant"),
            Column("ends", "range", is_number=True),
            Column("unit", "unit"),
            Column("evidence", "from"),
            Column("source", "source", place=Place.BELOW),
        ),
        rows=[
            {
                "name": one.name,
                "ends": ("times " if one.operation == "scale" else "plus " if one.operation == "add" else "")
                + f"{one.low:.4g} to {one.high:.4g}",
                "unit": one.unit,
                "evidence": evidence(one),
                "source": one.source,
            }
            for one in found.ranges
        ],
    )  # fmt: skip
    left_out = Table(
        columns=(
            Column("name", "left out"),
            Column("reason", "because", place=Place.BELOW),
        ),
        rows=found.left_out,
    )
    tables = [table for table in (ranges, left_out) if table.rows]
    parts: list[Part] = [part for table in tables for part in (table, Paragraph(""))]
    parts.append(
        Paragraph(
            f"{counted(len(found.ranges), 'range')}, {len(found.left_out)} left out. Draw uniformly; each joint apart."
        )
    )
    rows = [
        {"kind": "range", "subject": found.subject, **dataclasses.asdict(one)}
        for one in found.ranges
    ] + [
        {"kind": "left_out", "subject": found.subject, **dataclasses.asdict(one)}
        for one in found.left_out
    ]
    return Document(parts=tuple(parts), rows=rows)


# --- figures ---------------------------------------------------------------------------------------------------------

LONG_NAME = 48
"""Length at which the name of a world continues in a second line [characters]."""


def draw_transfer(report: TransferReport) -> Figure:
    """Return the picture of kept rewards: a point with its interval for each world."""
    rows = (report.training, *report.distinct)
    names = [
        "\n".join(wrap(row.world.name, LONG_NAME, break_on_hyphens=False))
        for row in rows
    ]
    # Two lines of a name need more height than one world has.
    figure = new_figure(
        9.0, 0.28 * len(rows) + 0.12 * sum("\n" in name for name in names) + 1.6
    )
    axis = figure.add_subplot()
    for place, row in enumerate(rows):
        color = REAL if place == 0 else OURS[1] if row.falls else OURS[0]
        kept = row.kept
        if kept.low is not None and kept.high is not None:
            axis.plot(
                [100 * kept.low, 100 * kept.high],
                [place, place],
                color=color,
                lw=2.0,
                solid_capstyle="round",
            )
        axis.plot(100 * kept.value, place, "o", color=color, ms=6)
        allowed = 100 * min(1.0, row.allowed)
        axis.plot(
            [allowed, allowed], [place - 0.4, place + 0.4], color="#707070", lw=1.2
        )
    axis.set_yticks(range(len(rows)), names, fontsize=8)
    axis.set_ylim(len(rows) - 0.5, -0.5)
    lowest = min(
        [
            0.0,
            *(row.kept.value if row.kept.low is None else row.kept.low for row in rows),
        ]
    )
    axis.set_xlim(100 * lowest - 5, None)
    axis.set_xlabel("reward kept [% of the promise]", loc="left", fontsize=9)
    note = (
        f"bar: what the law allows there; orange: below {100 * FALL_SHARE:.0f} % of it"
    )
    figure.suptitle(f"{report.task}   {note}", x=0.01, ha="left", fontsize=9)
    tidy_axis(axis)
    return figure
