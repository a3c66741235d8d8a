"""Write the rows of `gauge list`; no engine but MuJoCo 4 need be installed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from gauge_envs.backends.base import scene_support
from gauge_envs.backends.registry import uninstalled_backend
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.registry import engine_points
from gauge_envs.tools.catalog.listing import facts_of
from gauge_envs.tools.catalog.overview import STORED, inputs


def contents() -> Mapping[Path, str]:
    """Return the file with its text."""
    points = {point.name: point.value for point in engine_points()}
    bundled = {
        name: value
        for name, value in sorted(points.items())
        if value.startswith("gauge_envs.")
    }
    engines = {name: uninstalled_backend(name) for name in bundled}
    experiments = [
        load_experiment(variant) for variant in (*variants(), *beyond_variants())
    ]
    content = {
        "inputs": inputs(),
        "engines": bundled,
        "modules": {
            name: list(getattr(engine, "modules", ()))
            for name, engine in engines.items()
        },
        "facts": {one.variant.id: facts_of(one) for one in experiments},
        "lacks": {
            one.variant.id: {
                name: list(scene_support(engine, one.scene).missing)
                for name, engine in engines.items()
            }
            for one in experiments
        },
    }
    return {STORED: json.dumps(content, indent=1) + "\n"}
