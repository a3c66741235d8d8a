"""What the command line prints: rows for JSON, and the same as tables for reading."""

from gauge_envs.report.comparison import comparison_json, comparison_markdown, comparison_rows, comparison_view
from gauge_envs.report.control import control_description, control_summary, control_view
from gauge_envs.report.description import description, description_view
from gauge_envs.report.diagnosis import diagnosis_rows, diagnosis_view
from gauge_envs.report.listing import backend_rows, backend_table, list_rows, list_table
from gauge_envs.report.materials import material_values, material_view
from gauge_envs.report.results import configuration_labels, result_label, summary_view
from gauge_envs.report.text import (
    ALIGNED_TITLE,
    ENGINE_TITLES,
    GRADE_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    interval_text,
    score_text,
)

__all__ = [
    "ALIGNED_TITLE",
    "ENGINE_TITLES",
    "GRADE_NOTES",
    "METRIC_TITLES",
    "NORMALIZED_NOTE",
    "backend_rows",
    "backend_table",
    "comparison_json",
    "comparison_markdown",
    "comparison_rows",
    "comparison_view",
    "configuration_labels",
    "control_description",
    "control_summary",
    "control_view",
    "description",
    "description_view",
    "diagnosis_rows",
    "diagnosis_view",
    "interval_text",
    "list_rows",
    "list_table",
    "material_values",
    "material_view",
    "result_label",
    "score_text",
    "summary_view",
]
