"""Run a sanity check: the target's own model, then measured objects with its settings, then the search for a fix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from gauge_envs.registry import package_versions
from gauge_envs.tools.sanity.accepted import accept
from gauge_envs.tools.sanity.causes import absorb
from gauge_envs.tools.sanity.fixes.fix import FixSearch
from gauge_envs.tools.sanity.fixes.named import with_fix
from gauge_envs.tools.sanity.object_checks import GRASP
from gauge_envs.tools.sanity.object_checks.measure import (
    Measurements,
    applied_check,
)
from gauge_envs.tools.sanity.readers import configuration as configuration_of
from gauge_envs.tools.sanity.readers.gymnasium_env import Target
from gauge_envs.tools.sanity.report import screen_text
from gauge_envs.tools.sanity.robot.robot import mujoco_warnings
from gauge_envs.tools.sanity.selection import selection
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS
from gauge_envs.tools.sanity.training import TrainingConfiguration
from gauge_envs.tools.sanity.verdict import Report, SanityResult


@mujoco_warnings()
def check(
    target: Target | TrainingConfiguration,
    *,
    only: Sequence[str] = (),
    explain: bool = True,
    notify: Callable[[SanityResult], None] | None = None,
) -> Report:
    """Check the physics of a training configuration, and find the change of its settings that fixes most.

    Args:
        target: A `TrainingConfiguration`, or a target of `gauge_envs.tools.sanity.configuration`.
        only: Ids of checks or patterns such as `creep-*`; when empty, all checks of the target's own model and of rigid
            bodies. A model with a hand also gets those of grasps.
        explain: Whether to find the best fix.
        notify: Function that is called with each result as soon as it is complete.

    Returns:
        The report: checks of the target's own model, then of measured objects, in a fixed order.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no check.
        MissingExtraError: The backend's engine is not installed.
    """
    configuration = configuration_of(target)
    chosen = selection(only)
    has_hand = any(group.is_held for group in configuration.contact_groups)
    if has_hand and not only:
        chosen = (*chosen, *GRASP)
    found = _target_results(configuration, chosen, notify)
    results = absorb(accept(found, configuration))
    if explain and configuration.robot is not None:
        results = [with_fix(result, configuration.robot) for result in results]
    measurements = Measurements(configuration.backend)
    names = [name for name in chosen if name not in TARGET_CHECKS]
    objects = _object_results(measurements, configuration, names, notify)
    report = Report(
        configuration=configuration,
        checks=(*results, *accept(objects, configuration)),
        versions={**measurements.versions, **package_versions()},
        asked=tuple(name for name in chosen if name in only),
    )
    if explain:
        report = FixSearch(report, measurements).run()
    return replace(report, screen=screen_text(report))


def _target_results(
    configuration: TrainingConfiguration,
    names: Sequence[str],
    notify: Callable[[SanityResult], None] | None,
) -> list[SanityResult]:
    """Return the results of checks of the target itself."""
    results = []
    for name in names:
        if name in TARGET_CHECKS:
            results.append(TARGET_CHECKS[name].result(configuration))
            if notify is not None:
                notify(results[-1])
    return results


def _object_results(
    measurements: Measurements,
    configuration: TrainingConfiguration,
    names: Sequence[str],
    notify: Callable[[SanityResult], None] | None,
) -> list[SanityResult]:
    """Return the results of checks of measured objects."""
    results = []
    for name in names:
        results.append(applied_check(measurements, configuration, name).result())
        if notify is not None:
            notify(results[-1])
    return results
