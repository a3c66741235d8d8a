"""The skill for agents: it is short, its commands exist, and whoever follows it ends with a mended model."""

import os
import re
import shlex
import subprocess
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
from places import ROOT

from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import commands
from gauge_envs.cli.schemas import schema_names

SKILL = ROOT / ".agents" / "skills" / "gauge-envs" / "SKILL.md"
TEXT = SKILL.read_text()

MOST_WORDS = 400

FLAWED = """<mujoco model="walker">
  <option timestep="0.004" cone="pyramidal" impratio="1" iterations="4"/>
  <default><geom friction="0.8 0.005 0.0001" margin="0.01" solimp="0 0.8 0.01"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="trunk" pos="0 0 0.2">
      <freejoint/>
      <geom name="hull" type="box" size="0.15 0.1 0.04" mass="6"/>
      <geom name="FL_foot" type="sphere" size="0.02" pos="0.12 0.09 -0.18" mass="0.1"/>
      <geom name="FR_foot" type="sphere" size="0.02" pos="0.12 -0.09 -0.18" mass="0.1"/>
      <geom name="RL_foot" type="sphere" size="0.02" pos="-0.12 0.09 -0.18" mass="0.1"/>
      <geom name="RR_foot" type="sphere" size="0.02" pos="-0.12 -0.09 -0.18" mass="0.1"/>
    </body>
  </worldbody>
</mujoco>
"""
"""Four feet that float in a margin and creep: a soft, pyramidal contact with four iterations."""


def blocks(language):
    """Return the code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def creep_mm_per_s(xml):
    """Return how fast the feet slip on a board of 10 degrees, and their height above it [mm], in MuJoCo alone."""
    model = mujoco.MjModel.from_xml_string(xml)
    slope = np.radians(10.0)
    model.opt.gravity[:] = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    data = mujoco.MjData(model)

    def moved_to(end_s):
        while data.time < end_s:
            mujoco.mj_step(model, data)
        return data.body("trunk").xpos[0]

    start_m, end_m = moved_to(1.0), moved_to(3.0)
    return 1e3 * (end_m - start_m) / 2.0, 1e3 * (data.geom("FL_foot").xpos[2] - 0.02)


def mended(xml, line):
    """Return a model with the attributes that a line of advice states, as one would paste them."""
    tree = ET.fromstring(xml)
    found = re.findall(r"<(option|geom) ([^<>]*)/>", line)
    assert [element for element, _ in found] == ["option", "geom"]
    for element, stated in found:
        place = tree.find("option" if element == "option" else "default/geom")
        place.attrib.update(re.findall(r'(\w+)="([^"]*)"', stated))
    return ET.tostring(tree, encoding="unicode")


def test_it_is_short_and_states_when_to_use_it():
    assert len(TEXT.split()) <= MOST_WORDS
    start = TEXT.split("---")[1]
    assert f"name: {SKILL.parent.name}\n" in start
    assert "description: " in start


def test_its_commands_and_keys_exist():
    names = commands()
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    lines += re.findall(r"`(gauge [^`]*)`", TEXT)
    found = [shlex.split(line.partition(">")[0]) for line in lines]
    found = [words[1:] for words in found if words[0] == "gauge"]
    assert len(found) >= 10
    for words in found:
        name = next(name for name in (" ".join(words[:2]), words[0]) if name in names)
        known = {option for one in load_command(name).params for option in one.opts}
        stated = {word for word in words if word.startswith("-")}
        assert stated <= known, words
        if "--schema" in words:
            assert words[1] in schema_names()


@pytest.mark.slow
def test_following_it_leads_from_an_empty_folder_to_a_mended_model(wheel, tmp_path):
    """The creep and the height are those of MuJoCo alone, before and after."""
    model = tmp_path / "robot.xml"
    model.write_text(FLAWED)
    variables = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("PYTHON")
    }

    def follow(*parts):
        return subprocess.run(
            ["bash", "-e", "-c", "\n".join(parts)],
            cwd=tmp_path,
            env=variables | {"GAUGE_ENVS": str(wheel)},
            capture_output=True,
            text=True,
            check=False,
        )

    install, check, again, engines = blocks("sh")
    (read,) = blocks("python")
    activate = ". .venv/bin/activate"
    assert follow(install).returncode == 0
    checked = follow(activate, check)
    assert checked.returncode == 1, checked.stderr
    told = follow(activate, f"python - <<'END'\n{read}END")
    line, *rows = told.stdout.splitlines()
    assert {"foot-creep", "rest-height"} <= {row.partition(" ")[0] for row in rows}
    model.write_text(mended(FLAWED, line))
    done = follow(activate, again)
    assert done.returncode == 0, done.stderr
    after = (tmp_path / "after.jsonl").read_text()
    assert '"worst": "inside"' in after.splitlines()[0]
    (creep_before, height_before), (creep_after, height_after) = map(
        creep_mm_per_s, (FLAWED, model.read_text())
    )
    print(f"creep {creep_before:.3g} to {creep_after:.3g} mm/s", end=", ")
    print(f"height {height_before:.3g} to {height_after:.3g} mm; {line}")
    assert creep_before > 10.0 > 1.4 > creep_after >= 0.0
    assert height_before > 5.0 > 0.5 > abs(height_after)
    engine = follow(activate, engines)
    assert engine.returncode == 0, engine.stderr
    assert '"check": "slide-' in engine.stdout
    assert '"id": "GAUGE/SlopeSlider-' in engine.stdout
