"""Bundle the parts of three.js that the replays of `gauge report` need into one classic script (needs npm).

`python scripts/build_three.py` writes `gauge_envs/tools/site/assets/three.min.js` and its licence. Browsers load no
module from a folder, so the bundle is a script with one global, `THREE`. Versions are fixed; the bundle names them. A
second run makes the same bytes, which `--check` compares.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ASSETS = Path(__file__).parent.parent / "gauge_envs" / "tools" / "site" / "assets"

THREE, ESBUILD = "0.187.0", "0.28.2"

SHA256 = "39a12b6b39c021769337dc24f3cb9426edefa2cf8ab34194c05741674d4b64dd"
"""SHA-256 of the bundle."""

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


def main() -> None:
    """Write the bundle, or compare it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="compare with the files; write nothing"
    )
    check = parser.parse_args().check
    script, licence = bundle()
    digest = hashlib.sha256(script).hexdigest()
    print(f"{len(script)} bytes, SHA-256 {digest}")
    files = {ASSETS / "three.min.js": script, ASSETS / "three.LICENSE.txt": licence}
    if check:
        sys.exit(
            any(file.read_bytes() != content for file, content in files.items())
            or digest != SHA256
        )
    for file, content in files.items():
        file.write_bytes(content)
    if digest != SHA256:
        sys.exit("the bundle is new: write its SHA-256 into SHA256 of this script")


if __name__ == "__main__":
    main()
