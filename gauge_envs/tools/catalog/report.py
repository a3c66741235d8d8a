"""Report the list of experiments, and an experiment on one screen or completely."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.results import convergence_text
from gauge_envs.pages.table import Column, Facts, Table, grid
from gauge_envs.pages.text import (
    KIND_NOTES,
    METRIC_TITLES,
    counted,
    digits_text,
    event_title,
    pairs_text,
    plus_minus_text,
    quantity_text,
    score_text,
    short_id,
    shortened,
    value_text,
    with_unit,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.tools.catalog.spaces import range_text, shape_text

REFERENCES = {
    Kind.TRIALS: "mean of {} real trials",
    Kind.RECORDING: "one recorded real trial",
    Kind.ANALYTIC: "closed form of the calibrated scene, no real data",
    Kind.NUMERICAL: "refined numerical solution of the calibrated scene, no real data",
    Kind.NONE: "no reference motion",
}
"""Description of each kind of reference; `{}` is the number of trials."""

PLANTED_ERRORS = {
    "frozen": "no motion",
    "late_40_ms": "40 ms late",
    "friction_20_percent_lower": "friction 20 % lower",
    "friction_20_percent_higher": "friction 20 % higher",
    "stiffness_20_percent_lower": "stiffness 20 % lower",
    "stiffness_20_percent_higher": "stiffness 20 % higher",
}
"""Planted errors in the scene of MuJoCo, by column of `scoring/sees.csv`."""

UNDETECTABLE_SHARE = 0.1
"""Largest undetectable change of a score, divided by the standard uncertainty u."""


def family_table(
    rows: Sequence[Mapping[str, Any]], evaluated: Mapping[str, Sequence[str]]
) -> Table:
    """Return one row for each family: number of ids, kinds of reference, and what it evaluates.

    Args:
        rows: Result of `list_rows`.
        evaluated: Evaluated quantities of each family, as `["kinetic friction"]`.
    """
    families = dict.fromkeys(row["family"] for row in rows)
    summaries = []
    for family in families:
        kinds = Counter(row["kind"] for row in rows if row["family"] == family)
        kinds_text = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        evaluated_text = ", ".join(evaluated[family])
        summaries.append((family, kinds_text, evaluated_text))
    return grid(("family", "ids by kind of reference", "evaluates"), summaries)


def list_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the rows of `list_rows` as a table."""
    # Leave out engines that run nothing: they are broken or not installed.
    working = {
        name for row in rows for name, missing in row["backends"].items() if not missing
    }

    def usable_text(backends: Mapping[str, Sequence[str]]) -> str:
        usable = [name for name, missing in backends.items() if not missing]
        unusable = working.difference(usable)
        if len(usable) > 2 and len(unusable) < 2:
            return (
                " ".join(["all but", *unusable]) if unusable else f"all {len(usable)}"
            )
        return ", ".join(usable) or "none"

    imported = [short_id(row["id"]) for row in rows if row["imported"]]
    return Table(
        columns=(
            Column("id", "id"),
            Column("observable", "observable", wide_only=True),
            Column("frames", "frames", is_number=True, wide_only=True),
            Column("kind", "kind"),
            Column("backends", "runs on", usable_text),
        ),
        rows=rows,
        notes=(f"Real trials imported for {shortened(imported)}.",) if imported else (),
    )


# --- one screen -------------------------------------------------------------------------------------------------------


def experiment_document(values: Mapping[str, Any]) -> Document:
    """Return observable, reference, detected errors, engines and constants of an experiment.

    Args:
        values: Result of `description`.
    """
    observable, reference = values["observable"], values["reference"]
    measured = f"{observable['kind'].replace('_', ' ')} [{observable['unit']}]"
    measured += f" of {shortened(observable['coordinates'])}"
    exact = ", ".join(
        f"{score:.2f} ({name})" for name, score in reference["exact"].items()
    )
    facts = {
        "measured": f"{measured}; {values['frames']} frames at 30 Hz",
        "reference": reference_text(reference, frames=values["frames"]),
        "exact solution": f"scores {exact}, divided by real trials" if exact else "",
        "real events": events_text(reference["events"]),
        "planted errors": planted_errors_text(reference),
        "reward": reference["reward"],
        "action": "; ".join(
            f"{row['meaning']} ({row['unit']})"
            for row in values["action"]
            if row["unit"] != "1"
        )
        or "none",
        "observation": ", ".join(_entries(values["observation"])),
        "engines": _engines_text(values["engines"]),
        "published": _published_text(values["baselines"]),
        "published wrongly": reference["impossible"],
        **_asset_facts(values["asset"], values["gravity_m_per_s2"]),
        **_constants(values["constants"]),
    }
    limits = [counted(len(values["limits"]), "known limit")] if values["limits"] else []
    hidden = ", ".join([*limits, "sources, scene, spaces, decisions: --format wide"])
    return Document(
        parts=(
            Paragraph(f"{values['id']}  {values['title']}", Tone.ANSWER),
            Paragraph(values["summary"]),
            Paragraph(""),
            Facts({name: text for name, text in facts.items() if text}),
            Paragraph(hidden, Tone.NOTE),
        ),
        rows=[values],
    )


def reference_text(reference: Mapping[str, Any], *, frames: int) -> str:
    """Return the description of a reference, its uncertainty u, and the zero-motion distance."""
    kind = Kind(reference["kind"])
    if reference["single_shot"]:
        return "one real trial with the same initial state; it differs for each trial"
    text = REFERENCES[kind].format(reference["trial_count"])
    if reference["unit"] is None:
        return text
    uncertainty, zero_motion = (
        f"{quantity_text(reference[key])} {reference['unit']}"
        for key in ("standard_uncertainty", "zero_motion_distance")
    )
    text += f"; standard uncertainty u = {uncertainty}; a scene without motion is {zero_motion} away"
    if reference["known_frames"] < frames:
        text += f"; known at {reference['known_frames']} of {frames} frames"
    return text


def events_text(events: Sequence[Mapping[str, Any]]) -> str:
    """Return events with their real values and standard uncertainties; empty without events."""
    return "; ".join(
        f"{event_title(event['name'])}: "
        f"{plus_minus_text(event['value'], event['standard_uncertainty'], event['unit'])}"
        for event in events
    )


def planted_errors_text(reference: Mapping[str, Any]) -> str:
    """Return the scores of planted errors in a line; empty without planted errors."""
    texts = []
    for metric, scores in planted_error_scores(reference):
        detected = [f"{title} {score}" for title, score in scores.items() if score]
        text = f"{metric}: {', '.join(detected)}"
        undetectable = [title for title, score in scores.items() if not score]
        if undetectable:
            text += f"; undetectable: {', '.join(undetectable)}"
        texts.append(text)
    return ". ".join(texts)


def planted_error_scores(
    reference: Mapping[str, Any],
) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield each metric with its unit, and the score of each planted error by name; empty if undetectable.

    An error is undetectable if the score changes by less than a tenth of u, or not within three digits.
    """
    for row in reference["sees"]:
        has_uncertainty = row["unit"] == reference["unit"]
        uncertainty = reference["standard_uncertainty"] if has_uncertainty else 0.0
        unchanged = row["nominal"]
        scores = {"unchanged": digits_text(unchanged)}
        for key, title in PLANTED_ERRORS.items():
            score = row[key]
            if score is None:
                continue
            is_small = abs(score - unchanged) < UNDETECTABLE_SHARE * uncertainty
            is_equal = digits_text(score) == digits_text(unchanged)
            scores[title] = "" if is_small or is_equal else digits_text(score)
        unit = "" if row["unit"] == "1" else f" [{row['unit']}]"
        yield f"{event_title(row['metric'])}{unit}", scores


def _engines_text(engines: Sequence[Mapping[str, Any]]) -> str:
    """Return the engines that run here, that do not run here, and that cannot build the scene."""
    groups: dict[str, list[str]] = {"": [], "not here: ": [], "cannot build it: ": []}
    for row in engines:
        is_default = row["engine"] == EnvArguments.backend
        name = f"{row['engine']} (default)" if is_default else row["engine"]
        title = "not here: " if row["fault"] else ""
        groups["cannot build it: " if row["missing"] else title].append(name)
    return "; ".join(
        title + ", ".join(names) for title, names in groups.items() if names
    )


def _published_text(baselines: Sequence[Mapping[str, Any]]) -> str:
    """Return the published metrics of real trials and engine scores; empty without publications."""
    texts = []
    for line in baselines:
        scores = [
            f"{title} {score_text(line['engines'][key])}"
            for key, title in PUBLISHED_ENGINES.items()
        ]
        trials = plus_minus_text(line["mean"], line["std"], line["unit"])
        texts.append(
            f"{METRIC_TITLES[line['metric']]} {trials}; engines divided by it: {', '.join(scores)}"
        )
    return "; ".join(texts)


def _asset_facts(
    asset: Mapping[str, Any] | None, gravity_m_per_s2: float
) -> dict[str, str]:
    if asset is None:
        return {}
    return {
        "asset": f"{asset['file']}, sha256 {asset['sha256'][:8]}",
        "gravity": f"{gravity_m_per_s2:g} m/s^2",
        "edited": "; ".join(asset["changes"]) or "no: the calibrated scene",
    }


def _constants(
    constants: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> dict[str, str]:
    """Return constants and sources, with one entry for all bodies with equal constants."""
    bodies_of: dict[str, list[str]] = {}
    for body, table in constants.items():
        by_source: dict[str, dict[str, Any]] = {}
        for key, constant in table.items():
            by_source.setdefault(constant["source"], {})[key] = constant["value"]
        text = "; ".join(
            f"{pairs_text(group)} ({source})" for source, group in by_source.items()
        )
        bodies_of.setdefault(text, []).append(body)
    return {shortened(bodies): text for text, bodies in bodies_of.items()}


# --- complete description ---------------------------------------------------------------------------------------------


def full_document(values: Mapping[str, Any]) -> Document:
    """Return the screen of an experiment, followed by limits, engines, spaces, scene, decisions and sources."""
    limits = [
        limit["text"] + (f" (study: {limit['study']})" if limit["study"] else "")
        for limit in values["limits"]
    ]
    lists = {"Known limits": limits, "Decisions": values["decisions"]}
    return Document(
        parts=(
            *experiment_document(values).parts[:-1],
            *(Bullets(entries, title) for title, entries in lists.items() if entries),
            *_sections(values),
        ),
        rows=[values],
    )


def step_text(step_s: float) -> str:
    """Return a time step as a fraction of a second if it is one, otherwise in seconds."""
    fraction = Fraction(step_s).limit_denominator(1_000_000)
    return str(fraction) if fraction.numerator == 1 else f"{step_s:.4g}"


def reasons_text(missing: Sequence[str]) -> str:
    """Return the first reason why an engine cannot build a scene, and the number of the remaining reasons."""
    if len(missing) < 2:
        return "".join(missing)
    return f"{missing[0]} (and {len(missing) - 1} more)"


def _engine_text(row: Mapping[str, Any]) -> str:
    """Return preset and step of an engine, or the reason why it cannot build the scene."""
    if row["missing"] or row["timestep_s"] is None:
        return reasons_text(row["missing"])
    return f"preset {row['preset']}, step {step_text(row['timestep_s'])} s"


def convergence_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the measured changes by half the step and half the cell size, by engine."""
    has_cells = any(body["kind"] != "rigid" for body in values["bodies"])
    is_verified = Kind(values["reference"]["kind"]).is_solution
    return {
        row["engine"]: convergence_text(
            row["convergence"],
            has_cells=has_cells,
            with_unit=True,
            over_trials=not is_verified,
        )
        for row in values["engines"]
        if row["convergence"]
    }


def _sections(values: Mapping[str, Any]) -> Iterator[Part]:
    """Yield engines, spaces, scene and sources, each below its heading."""
    sources = {
        "evaluates": ", ".join(values["evaluates"]),
        "reference": values["reference"]["source"] or KIND_NOTES[Kind.NONE],
    }
    sections = {
        "Engines": {row["engine"]: _engine_text(row) for row in values["engines"]},
        "Convergence": convergence_facts(values),
        "Action and observation": _entries([*values["action"], *values["observation"]]),
        **{
            part.capitalize(): _numbered(values[part])
            for part in ("bodies", "contacts", "joints", "attachments", "drivers")
        },
        "Air": {
            name: value_text(value) for name, value in (values["air"] or {}).items()
        },
        "Sources": sources | values["source"],
        "Sources of numbers": values["provenance"],
        "Parameter sets": {
            name: f"{chosen['summary']}: {pairs_text(chosen['values']) or 'no change'}"
            for name, chosen in values["parameter_sets"].items()
        },
    }
    for title, facts in sections.items():
        if facts:
            yield Heading(title)
            yield Facts(facts)


def _numbered(parts: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the nonzero values of each part of a scene, by name or number."""
    texts = {}
    for number, part in enumerate(parts, 1):
        nonzero = {
            key: value
            for key, value in part.items()
            if (any(value) if isinstance(value, list) else value)
        }
        texts[part.get("name", str(number))] = pairs_text(nonzero, skip=("name",))
    return texts


def _entries(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the entries of spaces with shape, meaning and range of each part."""
    parts: dict[str, list[str]] = {}
    for row in rows:
        entry = f"{row['entry']} {shape_text(row['whole'])}".rstrip()
        text = f"{row['meaning']}, {with_unit(range_text(row), row['unit'])}"
        parts.setdefault(entry, []).append(text)
    return {entry: "; ".join(texts) for entry, texts in parts.items()}
