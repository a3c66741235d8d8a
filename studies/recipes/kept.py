"""Run `gauge sanity` on models with the lines of drawn recipes: no change that it offers may touch these lines.

PYTHONPATH=.:tests/tools/recipes python -m studies.recipes.kept FIRST_SEED LAST_SEED
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from gauge_envs.errors import GaugeError
from gauge_envs.tools.recipes import engine_settings, find_recipe
from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.fix_file import write_fix
from studies.recipes.draws import drawn

MODEL = """<mujoco>{snippet}
<worldbody><geom name="floor" type="plane" size="9 9 .1"/>
  <body pos="0 0 {radius}"><freejoint/><geom name="foot" type="sphere" size="{radius}" mass="{mass}"/></body>
</worldbody></mujoco>"""


def lines(text: str) -> list[dict[str, str]]:
    """Return the attributes of options and pairs of a model."""
    root = ElementTree.fromstring(text)
    return [
        dict(element.attrib) for tag in ("option", "pair") for element in root.iter(tag)
    ]


def kept(seed: int, folder: Path) -> bool:
    """Return whether the lines of a recipe are in the fixed file of its model, which the function prints."""
    aim, scale = drawn(seed)
    recipe = find_recipe(engine_settings("mujoco"), aim)
    text = MODEL.format(snippet=recipe.snippet, radius=0.03 * scale, mass=aim.mass_kg)
    file = folder / "model.xml"
    file.write_text(text)
    report = check(str(file))
    try:
        outcome = write_fix(report, folder / "fixed.xml")
    except GaugeError as error:
        outcome = str(error)
    fixed = folder / "fixed.xml"
    after = lines(fixed.read_text()) if fixed.exists() else lines(text)
    fixed.unlink(missing_ok=True)
    is_kept = all(
        given.items() <= now.items()
        for given, now in zip(lines(text), after, strict=False)
    )
    offered = [
        *(report.fix.changes if report.fix else ()),
        *(r.fix for r in report.checks if r.fix),
    ]
    print(
        seed,
        "kept" if is_kept else "LOST",
        offered,
        sorted(report.flags),
        outcome.split(": ", 1)[-1],
        flush=True,
    )
    return is_kept


if __name__ == "__main__":
    with TemporaryDirectory() as name:
        results = [
            kept(seed, Path(name))
            for seed in range(int(sys.argv[1]), int(sys.argv[2]) + 1)
        ]
    print(f"{sum(results)} of {len(results)} kept")
