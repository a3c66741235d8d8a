"""Run configurations, and results grouped by them.

A configuration consists of engine, versions, parameters or edited asset, given settings, initial-state noise, and
marker proxy. Results that differ only in their seed are repeats of one configuration.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from gauge_envs.backends.registry import is_bundled, uninstalled_backend
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.registry import package_versions
from gauge_envs.runs.result import Result


@dataclass(frozen=True, kw_only=True)
class RunConfiguration:
    """Engine, scene and settings of results.

    Attributes:
        backend: Name of the physics engine; None for a trajectory file of a user.
        parameters: Name of the parameter set, or the overrides.
        marker_proxy: Marker proxy of deformable bodies: `material` or `node`.
        settings_given: Numerical settings that replace those of the preset.
        jitter: Standard deviations of the initial state; empty without noise.
        asset: File and hash of an asset that differs from the scene of the task file; empty without one.
        engine_versions: Versions of the engine's packages.
    """

    backend: str | None
    parameters: str | Mapping[str, Any]
    marker_proxy: str = "material"
    settings_given: Mapping[str, Any] = field(default_factory=dict)
    jitter: Mapping[str, float] = field(default_factory=dict)
    asset: Mapping[str, str] = field(default_factory=dict)
    engine_versions: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, result: Result) -> RunConfiguration:
        """Return the configuration of a result."""
        common = package_versions()
        asset: dict[str, str] = {}
        if result.is_edited:
            asset = {key: result.asset[key] for key in ("file", "sha256")}
        return cls(
            backend=result.backend,
            parameters=result.parameters,
            settings_given=result.settings_given,
            jitter=result.jitter,
            marker_proxy=result.marker_proxy,
            asset=asset,
            engine_versions={
                name: text
                for name, text in result.versions.items()
                if name not in common
            },
        )

    @property
    def physics(self) -> str:
        """Result of `Backend.whose_physics` for an engine of this package; empty for other engines."""
        if self.backend is None or not is_bundled(self.backend):
            return ""
        return uninstalled_backend(self.backend).whose_physics(
            str(self.settings_given.get("preset", ""))
        )


def group_by_configuration(
    results: Iterable[Result],
) -> list[tuple[RunConfiguration, list[Result]]]:
    """Return configurations with their results, sorted by engine, published parameters and default settings first.

    A result of an episode that did not run has no engine versions. It joins the first configuration that agrees in all
    other fields.
    """
    groups: list[tuple[RunConfiguration, list[Result]]] = []
    for result in sorted(results, key=lambda result: result.error is not None):
        configuration = RunConfiguration.of(result)
        for known, members in groups:
            versions = configuration.engine_versions
            if result.error is not None:
                versions = known.engine_versions
            if known == replace(configuration, engine_versions=versions):
                members.append(result)
                break
        else:
            groups.append((configuration, [result]))
    return sorted(groups, key=lambda group: _order(group[0]))


def _order(configuration: RunConfiguration) -> tuple[str, bool, int, str]:
    has_other_proxy = configuration.marker_proxy != MarkerProxy.MATERIAL
    change_count = (
        len(configuration.settings_given)
        + len(configuration.jitter)
        + has_other_proxy
        + bool(configuration.asset)
    )
    return (
        configuration.backend or "",
        configuration.parameters != "published",
        change_count,
        json.dumps(list(asdict(configuration).values()), sort_keys=True),
    )
