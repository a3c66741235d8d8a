"""Run a sanity check: the target's own model, then measured objects with its settings, then the search for a fix."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.registry import package_versions
from gauge_envs.tools.sanity.causes import absorb, accept, entries
from gauge_envs.tools.sanity.fixes.fix import FixSearch
from gauge_envs.tools.sanity.fixes.named import with_fixes
from gauge_envs.tools.sanity.object_checks.measure import Measurements
from gauge_envs.tools.sanity.readers import configuration as configuration_of
from gauge_envs.tools.sanity.readers.gymnasium_env import Target
from gauge_envs.tools.sanity.report import screen_text
from gauge_envs.tools.sanity.target_checks import check_result, selection
from gauge_envs.tools.sanity.verdict import Report, SanityResult, TrainingConfiguration


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
        only: Ids of checks or patterns such as `creep-*`; all when empty.
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
    accepted = entries(configuration)
    measurements = Measurements(configuration.backend)
    results = []
    for name in chosen:
        results.append(check_result(measurements, configuration, name))
        if notify is not None:
            notify(results[-1])
    results, notes = accept(results, accepted)
    results = absorb(results)
    robot = configuration.robot if explain else None
    if robot is not None:
        results = with_fixes(results, configuration)
    report = Report(
        configuration=configuration,
        checks=tuple(results),
        versions={**measurements.versions, **package_versions()},
        asked=tuple(name for name in chosen if name in only),
        notes=notes,
    )
    if robot is not None:
        report = FixSearch(report, robot, measurements).run()
    return replace(report, screen=screen_text(report))
