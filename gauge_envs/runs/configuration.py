"""Run configurations, and results grouped by them.

A configuration states what was tested: the engine and its versions, the parameters of the scene or the edited asset,
the settings that were given, the jitter of the start, and the marker proxy. Results that differ only in their seed are
repeats of one configuration.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from gauge_envs.backends.registry import is_bundled, uninstalled_backend
from gauge_envs.files import versions
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.runs.result import Result


@dataclass(frozen=True, kw_only=True)
class RunConfiguration:
    """What was tested.

    Attributes:
        backend: Name of the physics engine; None for a trajectory file of a user.
        parameters: Name of the parameter set, or the overrides.
        settings_given: Numerical settings that replace those of the preset.
        jitter: Standard deviations of the start; empty without jitter.
        marker_proxy: Marker proxy of deformable bodies: `material` or `node`.
        asset: File and hash of an asset that differs from the calibrated scene; empty without one.
        engine_versions: Versions of the engine's packages.
    """

    backend: str | None
    parameters: str | Mapping[str, Any]
    settings_given: Mapping[str, Any] = field(default_factory=dict)
    jitter: Mapping[str, float] = field(default_factory=dict)
    marker_proxy: str = "material"
    asset: Mapping[str, str] = field(default_factory=dict)
    engine_versions: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, result: Result) -> RunConfiguration:
        """Return the configuration of a result."""
        common = versions()
        return cls(
            backend=result.backend,
            parameters=result.parameters,
            settings_given=result.settings_given,
            jitter=result.jitter,
            marker_proxy=result.marker_proxy,
            asset={key: result.asset[key] for key in ("file", "sha256")}
            if result.is_edited
            else {},
            engine_versions={
                name: text
                for name, text in result.versions.items()
                if name not in common
            },
        )

    @property
    def physics(self) -> str:
        """Whose physics an engine of this package shows, by `Backend.whose_physics`; else empty."""
        if self.backend is None or not is_bundled(self.backend):
            return ""
        return uninstalled_backend(self.backend).whose_physics(
            str(self.settings_given.get("preset", ""))
        )


def group_by_configuration(
    results: Iterable[Result],
) -> list[tuple[RunConfiguration, list[Result]]]:
    """Return configurations with their results, sorted by engine, calibrated parameters and default settings first.

    A result of an episode that did not run has no versions of the engine. It joins the first configuration that agrees
    in everything else.
    """
    groups: list[tuple[RunConfiguration, list[Result]]] = []
    for result in sorted(results, key=lambda result: result.error is not None):
        wanted = RunConfiguration.of(result)
        for one, members in groups:
            if result.error is not None:
                wanted = replace(wanted, engine_versions=one.engine_versions)
            if one == wanted:
                members.append(result)
                break
        else:
            groups.append((RunConfiguration.of(result), [result]))
    return sorted(groups, key=lambda group: _order(group[0]))


def _order(one: RunConfiguration) -> tuple[str, bool, int, str]:
    changes = (one.settings_given, one.jitter, one.asset, one.engine_versions)
    changed = (
        len(one.settings_given)
        + len(one.jitter)
        + (one.marker_proxy != MarkerProxy.MATERIAL)
        + bool(one.asset)
    )
    return (
        one.backend or "",
        one.parameters != "calibrated",
        changed,
        json.dumps((one.parameters, one.marker_proxy, *changes), sort_keys=True),
    )
