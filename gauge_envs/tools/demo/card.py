"""Make the cards of the demo. Every number of a card is measured when the card is made."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import GaugeError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.html import Html, element, folded, join
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.answers import DistanceCause
from gauge_envs.tools.control import stored_policy
from gauge_envs.tools.demo.measure import (
    BALL,
    CREEP,
    ROBOT,
    TASK,
    Drop,
    creep,
    drop,
    real_drops,
    used_friction,
)

SHARE = 0.98
"""Share of the maximum that the law's policy uses."""

POLICY = f"""\
import gymnasium, gauge_envs
from gauge_envs.tools.control import stored_policy

policy = stored_policy("{TASK.removeprefix("GAUGE/")}")
env = gymnasium.make("{TASK}")
seen, _ = env.reset(seed=0)
over = False
while not over:
    seen, _, end, cut, info = env.step(policy(seen))
    over = end or cut
print(f"{{info['limit'].ratio:.0%}}")"""


@dataclass(frozen=True, kw_only=True)
class Card:
    """One result.

    Attributes:
        title: What is measured.
        value: The number, as text.
        unit: Its unit.
        text: The result in sentences.
        command: Command or Python code that prints the number.
        shapes: Shapes of its picture, which is 280 wide and 190 high.
        is_wrong: Whether the number is an error.
    """

    title: str
    value: str = ""
    unit: str = ""
    text: str
    command: str
    shapes: tuple[Html, ...] = ()
    is_wrong: bool = True

    def html(self) -> Html:
        """Return the card as markup."""
        number = f"number {'wrong' if self.is_wrong else 'right'}"
        code = element("pre", element("code", join(self.command.splitlines(), "\n")))
        if "\n" in self.command:
            code = folded("Python code", code)
        return element(
            "article",
            element("h2", self.title),
            element("svg", *self.shapes, viewBox="0 0 280 190", aria_hidden="true"),
            element("p", self.value, element("small", f" {self.unit}"), class_=number),
            element("p", self.text),
            element("footer", code),
        )


def cards() -> Iterator[Card]:
    """Yield the four cards."""
    published = drop()
    yield ball_card(published)
    yield constants_card(published)
    yield contacts_card()
    yield policy_card()


def ball_card(simulated: Drop) -> Card:
    """Return the drop with published constants beside the real drops."""
    frames_s, trials_mm = real_drops()
    score = simulated.result.score
    count, exact_mm = len(trials_mm), simulated.exact_mm
    text = (
        f"MuJoCo's ball is {score.distance:.0f} mm from the mean of {count} real drops; "
        f"an exact solver is {exact_mm:.0f} mm off."
    )
    if score.cause is DistanceCause.CONSTANTS:
        text += " So the constants are wrong, not the engine."
    ends = (0.0, frames_s[-1]), (trials_mm.min(), trials_mm.max())
    shown = (simulated.times_s >= 0.0) & (simulated.times_s <= frames_s[-1])
    curve = simulated.times_s[shown], simulated.heights_mm[shown]
    balls = (
        element("circle", cx=x, cy=y, r=3.4, class_="real faint")
        for trial_mm in trials_mm
        for x, y in _points(frames_s, trial_mm, *ends)
    )
    return Card(
        title="Your engine against reality",
        value=f"{score.distance:.0f}",
        unit="mm",
        text=text,
        command=f"gauge run {BALL}",
        shapes=(
            _curve(((6, 178), (274, 178))),
            *balls,
            _curve(_points(*curve, *ends), "wrong"),
            _words(268, 60, f"{count} real drops", is_right=True),
            _words(268, 150, "MuJoCo", "wrong", is_right=True),
        ),
    )


def constants_card(published: Drop) -> Card:
    """Return the errors with published and with measured constants."""
    restitutions = {
        name: load_experiment(BALL, name).scene.contacts[0].restitution
        for name in ("published", "measured")
    }
    measured = drop(parameters="measured")
    restitution = drop(parameters={"ball.restitution": restitutions["measured"]})
    rows = {
        f"published restitution {restitutions['published']:.2f}": published,
        f"measured restitution {restitutions['measured']:.2f}": restitution,
        "and measured heights": measured,
    }
    errors = [run.result.score.distance or 0.0 for run in rows.values()]
    before, _, after = texts = [f"{error:.{int(error < 10)}f}" for error in errors]
    shapes = []
    for index, (title, error) in enumerate(zip(rows, errors, strict=True)):
        look = "right" if index else "wrong"
        y, width = 22 + 60 * index, 190.0 * error / max(errors) + 2.0
        shapes += [
            _words(8, y, title),
            element("rect", x=8, y=y + 8, width=width, height=20, class_=look),
            _words(18 + width, y + 24, f"{texts[index]} mm", "bold"),
        ]
    return Card(
        title="Your constants",
        value=after,
        unit="mm",
        text=f"Measured restitution and heights cut the error from {before} to {after} mm. "
        "They were measured on the same drops.",
        command=f"gauge run {BALL} -p measured",
        shapes=tuple(shapes),
        is_wrong=False,
    )


def contacts_card() -> Card:
    """Return the creep of a cube with the contacts of a robot, or why it is not measured."""
    title = "Your robot's contacts"
    command = f"gauge sanity {ROBOT} --only {CREEP}"
    try:
        result = creep()
    except GaugeError as error:
        return Card(title=title, text=f"Not measured: {error}", command=command)
    speed = result.configured or 0.0
    board = join(
        [
            element("rect", x=0, y=0, width=262, height=12, class_="board"),
            element("rect", x=14, y=-62, width=62, height=62, class_="real"),
            element(
                "rect",
                x=14 + 1.25 * speed,
                y=-62,
                width=62,
                height=62,
                class_="wrong faint",
            ),
        ]
    )
    return Card(
        title=title,
        value=f"{speed:.0f}",
        unit="mm/s",
        text=f"With the contacts of HalfCheetah a wooden cube creeps down 10 degrees at {speed:.0f} mm/s. "
        f"A real cube creeps by less than {result.reality.tolerance:.1f} mm/s.",
        command=command,
        shapes=(
            element("g", board, transform="translate(12,108) rotate(10)"),
            _words(20, 32, "real: rests"),
            _words(150, 52, "after 1 s", "wrong"),
            _words(20, 172, "slope 10°"),
        ),
    )


def policy_card() -> Card:
    """Return the shares of the maximum that a trained policy, the law's own and two constant actions reach."""
    policy = stored_policy(TASK.removeprefix("GAUGE/"))
    trained, report = used_friction(lambda _, observation: policy(observation))
    _, law_report = used_friction(lambda env, _: env.law_action(SHARE))
    full, full_report = used_friction(lambda *_: 1.0)
    _, zero_report = used_friction(lambda *_: 0.0)
    limit = report.limit.value
    ends = (0.0, len(trained)), (0.0, 1.2 * limit)
    y = _points(np.zeros(1), np.array([limit]), *ends)[0][1]
    return Card(
        title="Your policy against the maximum",
        value=f"{100 * report.ratio:.0f}",
        unit="%",
        text=f"PPO reaches {100 * report.ratio:.0f} % of the maximum after 60,000 steps, the law's own policy "
        f"{100 * law_report.ratio:.0f} %, zero actions {100 * zero_report.ratio:.0f} %. With full acceleration the "
        f"cube {full_report.ending}: {100 * full_report.ratio:.0f} %.",
        command=POLICY,
        shapes=(
            _curve(((6, 178), (274, 178))),
            _curve(((14, y), (266, y)), "dashed"),
            _curve(
                _points(np.arange(float(len(full))), np.array(full), *ends), "wrong"
            ),
            _curve(
                _points(np.arange(float(len(trained))), np.array(trained), *ends),
                "right",
            ),
            _words(266, y - 8, "maximum", is_right=True),
            _words(266, y + 34, "PPO", "right", is_right=True),
            _words(70, y - 8, "slips", "wrong"),
            _words(266, 172, "zero actions", is_right=True),
        ),
        is_wrong=False,
    )


# --- shapes ----------------------------------------------------------------------------------------------------------


def _points(
    x: FloatArray,
    y: FloatArray,
    x_ends: tuple[float, float],
    y_ends: tuple[float, float],
) -> list[tuple[float, float]]:
    """Return the places of values in a picture, given the values at its ends."""
    across = 14.0 + 252.0 * (x - x_ends[0]) / np.ptp(x_ends)
    up = 168.0 - 142.0 * (y - y_ends[0]) / np.ptp(y_ends)
    return list(zip(across.round(1).tolist(), up.round(1).tolist(), strict=True))


def _curve(points: Sequence[tuple[float, float]], look: str = "axis") -> Html:
    text = " ".join(f"{x},{y}" for x, y in points)
    return element("polyline", points=text, class_=look)


def _words(
    x: float, y: float, text: str, look: str | None = None, *, is_right: bool = False
) -> Html:
    anchor = "end" if is_right else None
    return element("text", text, x=x, y=y, class_=look, text_anchor=anchor)
