"""Identified settings of joints as tables, and in the language of each engine."""

import tomllib
from dataclasses import asdict
from pathlib import Path
from string import Formatter

from gauge_envs.pages.document import Document
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.identify.fit import Identified

KV_NOTE = "kv belongs to this engine and step: one that is implicit in the angle damps by kp times the step besides."


def identified_document(found: Identified) -> Document:
    """Return the numbers with intervals, and the errors of the logs."""

    def number(key: str, title: str) -> Column:
        return Column(key, title, lambda value: f"{value:.4g}", is_number=True)

    has_kv = any(one.name == "kv_n_m_s_per_rad" for one in found.settings)
    numbers = Table(
        columns=(
            Column("joint", f"{found.engine}: joint"),
            Column("name", "setting"),
            number("value", "value"),
            number("low", "low"),
            number("high", "high"),
            Column("unknown", "not determined"),
        ),
        rows=[asdict(one) for one in found.settings],
        notes=(
            "low and high are the ends of the 95 % interval.",
            *([KV_NOTE] if has_kv else []),
            "",
        ),
    )
    rows = [
        {
            "log": name,
            "used": used,
            "joint": joint,
            "error": 1e3 * float(error),
            "motion": 1e3 * float(motion),
        }
        for used, errors in (
            ("fitted", found.error_rad),
            ("held out", found.held_out_rad),
        )
        for name, values in errors.items()
        for joint, (error, motion) in enumerate(
            zip(values, found.motion_rad[name], strict=True)
        )
    ]
    errors = Table(
        columns=(
            Column("log", "log"),
            Column("used", ""),
            Column("joint", "joint"),
            number("error", "rms error [mrad]"),
            number("motion", "rms motion [mrad]"),
        ),
        rows=rows,
    )
    return Document(
        parts=(numbers, errors),
        rows=[{"engine": found.engine, "settings": numbers.rows, "errors": rows}],
    )


def snippet(found: Identified) -> str:
    """Return all numbers of each joint in the language of the engine, and those that no line of it sets."""
    engines = tomllib.loads(
        (Path(__file__).parent / "snippets.toml").read_text(encoding="utf-8")
    )
    lines = []
    for joint, terms in enumerate(found.joints):
        values, said = (
            {name: f"{value:.5g}" for name, value in terms.items()},
            set[str](),
        )
        for one in engines.get(found.engine, ()):
            if all(map(terms.get, one.get("needs", ()))) and not any(
                map(terms.get, one.get("without", ()))
            ):
                lines.append(one["line"].format(joint=joint, **values))
                said |= {
                    name for _, name, _, _ in Formatter().parse(one["line"]) if name
                }
        lines += [
            f"# joint {joint}: {name} = {values[name]}, which no line above sets: apply it in your controller"
            for name, value in terms.items()
            if value and name not in said
        ]
    return "\n".join(lines) + "\n"
