"""In a browser, every page opens from its folder without a message and draws its 3D views."""

import re
import shutil
import subprocess

import pytest

from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.tools.site import save_site

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), "")

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--enable-logging=stderr",
    "--virtual-time-budget=5000",
    "--dump-dom",
)

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not BROWSER, reason="no Chromium")]

NAMES = ("SlopeSlider-2-wood", "NewtonsCradle-metal", "BouncingBall-rubber")


def opened(page, width, profile):
    """Return the document of a page after five seconds, and the messages of its scripts."""
    options = (f"--window-size={width},3000", f"--user-data-dir={profile}")
    command = [BROWSER, *FLAGS, *options, page.as_uri()]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout, re.findall(r"CONSOLE.*", done.stderr)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    requests = [
        RunRequest(name, settings=settings)
        for name in NAMES
        for settings in (None, {"timestep_s": 1 / 900})
    ]
    list(run_many(requests, out=folder))
    out = folder / "site"
    save_site({file: load_result(file) for file in sorted(folder.glob("*.json"))}, out)
    return out


@pytest.mark.parametrize("width", [1200, 390])
def test_every_page_opens_without_a_message(width, site, tmp_path):
    pages = sorted(site.glob("*.html"))
    assert len(pages) == len(NAMES) + 1
    for page in pages:
        document, messages = opened(page, width, tmp_path)
        assert messages == [], page.name
        # The script sets the size of each drawn picture.
        drawn = re.findall(r"<canvas width=", document)
        assert len(drawn) == (2 if page.name.startswith("experiment") else 0)
