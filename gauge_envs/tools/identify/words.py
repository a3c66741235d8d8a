"""Identified settings of joints as tables."""

from dataclasses import asdict

from gauge_envs.pages.document import Document
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.identify.fit import Identified

KV_NOTE = "kv belongs to this engine and step: one that is implicit in the angle damps by kp times the step besides."

REPLAY_NOTE = "rms error is that of the lines below in plain MuJoCo, each log as a whole from its recorded start."
PLAIN_NOTE = "Without a model: angle = command; lag has five numbers: gain, offset, delay, time constant, play."


def _plain(found: Identified, log: str, joint: int) -> dict[str, float]:
    """Return errors of the plain laws [mrad]."""
    if log not in found.plain_rad:
        return {}
    command, lag = 1e3 * found.plain_rad[log][:, joint]
    return {"command": float(command), "lag": float(lag)}


def identified_document(found: Identified) -> Document:
    """Return the numbers with intervals, and the errors of the logs."""

    def number(key: str, title: str, absent: str = "") -> Column:
        return Column(
            key,
            title,
            lambda value: absent if value is None else f"{value:.4g}",
            is_number=True,
        )

    has_kv = any(one.name == "kv_n_m_s_per_rad" for one in found.settings)
    numbers = Table(
        columns=(
            Column("joint_name", f"{found.engine}: joint"),
            Column("name", "setting"),
            number("value", "value"),
            number("low", "low"),
            number("high", "high"),
            number("pasted", "pasted", "left out"),
            Column("unknown", "not determined"),
        ),
        rows=[asdict(one) for one in found.settings],
        notes=(
            "low and high are the ends of the 95 % interval. What has no pasted value stays as the scene states it.",
            *([KV_NOTE] if has_kv else []),
            "",
        ),
    )
    rows = [
        {
            "log": name,
            "used": used,
            "joint": joint,
            "joint_name": found.names[joint],
            "error": 1e3 * float(error),
            **_plain(found, name, joint),
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
            Column("joint_name", "joint"),
            number("error", "rms error [mrad]"),
            *(
                [number("command", "angle = command"), number("lag", "lag")]
                if found.plain_rad
                else []
            ),
            number("motion", "rms motion [mrad]"),
        ),
        rows=rows,
        notes=((REPLAY_NOTE,) if found.is_replayed else ()) + ((PLAIN_NOTE,) if found.plain_rad else ()),
    )  # fmt: skip
    return Document(
        parts=(numbers, errors),
        rows=[{"engine": found.engine, "settings": numbers.rows, "errors": rows}],
    )
