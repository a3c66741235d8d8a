"""Lines of a report that say what the choice of an estimator does, and when the events of a swing happen."""

from __future__ import annotations

from collections.abc import Iterator

from gauge_envs.evaluation.score import Score


def estimator_lines(name: str, score: Score) -> Iterator[str]:
    """Yield the lines of one result; none for a score without event metrics.

    Args:
        name: Id of the experiment, as `NewtonsCradle-metal`.
        score: Its score.
    """
    if score.lsd_s is not None:
        counted = _value(score.lsd_s, score.lsd_normalized)
        central = _value(score.lsd_central_s, score.lsd_central_normalized)
        in_space = _value(score.lsd_speed_3d_s, score.lsd_speed_3d_normalized)
        first, last = score.lsd_dropped_rests_s or (0.0, 0.0)
        yield (
            f"{name}: LSD limits the speed of the height from frame to frame: {counted}. With central differences it "
            f"is {central}, with the speed in space {in_space}. Rests that touch the first frame ({first:.3f} s) or "
            f"the last ({last:.3f} s) do not count."
        )
    if score.pd_s is not None:
        counted = _value(score.pd_s, score.pd_normalized)
        plain = _value(score.pd_fft_s, score.pd_fft_normalized)
        yield (
            f"{name}: PD is the peak of the windowed spectrum between the bins: {counted}. The strongest bin of the "
            f"plain spectrum gives {plain}."
        )
    yield from _event_lines(name, score)


def _value(value_s: float | None, normalized: float | None) -> str:
    """Return a duration, with its share of the published mean in brackets."""
    share = "" if normalized is None else f" ({normalized:.2f})"
    return "-" if value_s is None else f"{value_s:.3f} s{share}"


def _event_lines(name: str, score: Score) -> Iterator[str]:
    events = score.events or ()
    for quantity in dict.fromkeys(event.quantity for event in events):
        of_kind = [event for event in events if event.quantity == quantity]
        pairs = ", ".join(
            f"{'-' if event.simulated_s is None else f'{event.simulated_s:.2f}'} / {event.recorded_s:.2f}"
            for event in of_kind
        )
        yield f"{name}: last ball {quantity} [s], simulated / recorded (+- {of_kind[0].sigma_s:.2f}): {pairs}."
