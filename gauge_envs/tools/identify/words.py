"""Identified settings of joints as tables."""

from dataclasses import asdict

from gauge_envs.pages.document import Document
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.identify.identified import Identified

KV_NOTE = "kv belongs to this engine and step: one that is implicit in the angle damps by kp times the step besides."

REPLAY_NOTE = (
    "rms error is that of the lines below in plain MuJoCo, each log as a whole. It starts with the recorded rates, or "
    "with the angle and rate of a parabola through 0.05 s."
)
START_NOTE = "rms error of a fitted log is from its fitted start, of a held out one from its recorded start."
STEP_NOTE = "{joint}: half the step moves the fitted logs by {step:.2g} mrad: the numbers hold at this step alone."
PLAIN_NOTES = {
    "lag": "Without a model: angle = command; lag has five numbers: gain, offset, delay, time constant, play.",
    "cosine": "Without a model: a decaying cosine of three numbers: angle at rest, decay, frequency.",
}
ONE_FILE = "One file says nothing about the next: fit several to see how far values differ between files."
NEXT_NOTE = "next file: 95 % interval of what another would give; each of {files} files has a random effect (REML)."
FIT_NOTE = "fit low and high are the 95 % interval of the least squares over all files, as if one law held for all."
LAW_NOTE = "Each {part} was fitted alone. {other}: predictions of it by the rest, from its recorded start."

ALIKE = "{alike} are not told apart by these logs, within a standard error: {first} is used, with the fewest terms."
TELLING = "Fast steps under two loads tell M4 to M6, and falls with the motor off; slow motions do not."


def _number(key: str, title: str, absent: str = "") -> Column:
    return Column(
        key,
        title,
        lambda value: absent if value is None else f"{value:.4g}",
        is_number=True,
    )


def identified_document(found: Identified) -> Document:
    """Return the numbers with intervals, the laws that were compared, and the errors of the logs."""
    numbers, laws, errors = _numbers(found), _laws(found), _errors(found)
    return Document(
        parts=(*([laws] if found.laws else []), numbers, errors),
        rows=[
            {
                "engine": found.engine,
                "files": found.files,
                "laws": laws.rows,
                "settings": numbers.rows,
                "trades": found.trades,
                "errors": errors.rows,
            }
        ],
    )


def _numbers(found: Identified) -> Table:
    has_kv = any(one.name == "kv_n_m_s_per_rad" for one in found.settings)
    several = found.files > 1
    return Table(
        columns=(
            Column("joint_name", f"{found.engine}: joint"),
            Column("name", "setting"),
            _number("value", "value"),
            *(
                [_number("next_low", "next file low"), _number("next_high", "high")]
                if several
                else []
            ),
            _number("low", "fit low"),
            _number("high", "high"),
            _number("pasted", "pasted", "left out"),
            Column("unknown", "not determined"),
        ),
        rows=[asdict(one) for one in found.settings],
        notes=(
            NEXT_NOTE.format(files=found.files) if several else ONE_FILE,
            f"{FIT_NOTE} What has no pasted value stays as the scene states it.",
            *found.trades,
            *([KV_NOTE] if has_kv else []),
            *_coarse(found),
            "",
        ),
    )


def _coarse(found: Identified) -> list[str]:
    """Return the joints that the step of the engine moves by more than their sensor's noise."""
    return [
        STEP_NOTE.format(joint=joint, step=1e3 * step_rad)
        for joint, step_rad, noise_rad in zip(
            found.names, found.step_rad, found.noise_rad, strict=False
        )
        if step_rad > noise_rad
    ]


def _laws(found: Identified) -> Table:
    several = found.files > 1
    part, other = (
        ("file", "other file") if several else ("half of the log", "other half")
    )
    return Table(
        columns=(
            Column("name", f"{found.engine}: law of friction"),
            _number("fitted", "fitted [mrad]"),
            _number("held_out", f"{other}s [mrad]" if several else f"{other} [mrad]"),
        ),
        rows=[
            {
                "name": one.name,
                "fitted": 1e3 * one.fitted_rad,
                "held_out": 1e3 * one.held_out_rad,
                "is_as_good": one.is_as_good,
            }
            for one in found.laws
        ],
        notes=(
            LAW_NOTE.format(part=part, other=other),
            _choice(found),
            "",
        ),
    )


def _choice(found: Identified) -> str:
    """Return why the first law is used, and which laws the logs do not tell apart; "" where none was compared."""
    if not found.laws:
        return ""
    alike = [one.name for one in found.laws if one.is_as_good]
    if len(alike) == 1:
        return f"{alike[0]} is used: no other law fits and predicts as well, within a standard error."
    reason = ALIKE.format(alike="; ".join(alike), first=alike[0])
    is_by_load = len({"M4", "M5", "M6"} & {*alike}) > 1
    return f"{reason} {TELLING}" if is_by_load else reason


def _errors(found: Identified) -> Table:
    plain = list(
        dict.fromkeys(name for one in found.plain_rad.values() for name in one)
    )
    titles = {"command": "angle = command"}
    rows = [
        {
            "log": log,
            "used": used,
            "joint": joint,
            "joint_name": found.names[joint],
            "error": 1e3 * float(error),
            **{name: 1e3 * float(found.plain_rad[log][name][joint]) for name in plain},
            "motion": 1e3 * float(motion),
            "noise": 1e3 * float(found.noise_rad[joint]),
            "pattern": found.patterns[log][joint] if log in found.patterns else "",
        }
        for used, errors in (
            ("fitted", found.error_rad),
            ("held out", found.held_out_rad),
        )
        for log, values in errors.items()
        for joint, (error, motion) in enumerate(
            zip(values, found.motion_rad[log], strict=True)
        )
    ]
    return Table(
        columns=(
            Column("log", "log"),
            Column("used", ""),
            Column("joint_name", "joint"),
            _number("error", "rms error [mrad]"),
            *(_number(name, titles.get(name, name)) for name in plain),
            _number("motion", "rms motion [mrad]"),
            _number("noise", "sensor noise [mrad]"),
            Column("pattern", "looks like"),
        ),
        rows=rows,
        notes=(
            REPLAY_NOTE if found.is_replayed else START_NOTE,
            *(PLAIN_NOTES[name] for name in plain if name in PLAIN_NOTES),
        ),
    )
