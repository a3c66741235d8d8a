"""Bundle the parts of three.js that the replays of `gauge report` need into one classic script (needs npm).

Browsers load no module from a folder, so the bundle is a script with one global, `THREE`. The bundle names its
versions.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from scripts.generated import ROOT, Request

ASSETS = ROOT / "gauge_envs" / "tools" / "site" / "assets"

THREE, ESBUILD = "0.187.0", "0.28.2"

USED = (
    "BoxGeometry",
    "BufferAttribute",
    "BufferGeometry",
    "CapsuleGeometry",
    "Color",
    "CylinderGeometry",
    "DirectionalLight",
    "DoubleSide",
    "EdgesGeometry",
    "Float32BufferAttribute",
    "GridHelper",
    "Group",
    "HemisphereLight",
    "InstancedMesh",
    "Line",
    "LineBasicMaterial",
    "LineSegments",
    "Matrix4",
    "Mesh",
    "MeshBasicMaterial",
    "MeshLambertMaterial",
    "PerspectiveCamera",
    "PlaneGeometry",
    "Points",
    "PointsMaterial",
    "Quaternion",
    "Scene",
    "SphereGeometry",
    "Vector3",
    "WebGLRenderer",
)
"""Names of three.js that `replay.js` uses."""


def bundle() -> tuple[bytes, bytes]:
    """Return the bundle and the licence of three.js."""
    npm = shutil.which("npm")
    if npm is None:
        raise SystemExit("npm is needed: install Node.js")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "package.json").write_text('{"private": true}')
        packages = [f"three@{THREE}", f"esbuild@{ESBUILD}"]
        subprocess.run(
            [npm, "install", "--no-audit", "--no-fund", *packages],
            cwd=folder,
            check=True,
        )
        (folder / "entry.js").write_text(
            f"export {{ {', '.join(USED)} }} from 'three';\n"
            "export { OrbitControls } from 'three/addons/controls/OrbitControls.js';\n"
        )
        out = folder / "three.min.js"
        options = [
            "--bundle",
            "--minify",
            "--format=iife",
            "--global-name=THREE",
            "--target=es2020",
        ]
        banner = f"/*! three.js {THREE}, MIT licence: three.LICENSE.txt. Bundled by esbuild {ESBUILD}. */"
        tool = folder / "node_modules" / ".bin" / "esbuild"
        command = [
            tool,
            "entry.js",
            *options,
            "--legal-comments=none",
            f"--banner:js={banner}",
            f"--outfile={out}",
        ]
        subprocess.run(command, cwd=folder, check=True)
        return out.read_bytes(), (
            folder / "node_modules" / "three" / "LICENSE"
        ).read_bytes()


def measure(request: Request) -> None:
    """Write the bundle and the licence."""
    script, licence = bundle()
    (ASSETS / "three.min.js").write_bytes(script)
    (ASSETS / "three.LICENSE.txt").write_bytes(licence)
