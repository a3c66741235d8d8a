"""Open a USD file and read all its values, in a child process whose memory and time are limited.

The script is started by `source.Source` and imports nothing of this package. Arguments: the file, the largest number of
prims, and the folders in which all files that it refers to must be; without folders, they may be anywhere.
"""

import sys
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd

REFUSED = 3
"""Exit code after a printed reason, as in `files.child_refusal`."""

MOST_SAMPLES = 100_000
"""Largest number of time samples of an attribute."""


def main(file: str, most_prims: int, folders: list[str]) -> int:
    """Print why the file is refused, if it is, and return the exit code."""
    try:
        # Errors of USD quote what they read, so nothing outside is opened at all.
        if outside := _outside(file, folders):
            print(
                f"it refers to {outside}, outside its folder: move that there, or set GAUGE_OUTSIDE_FILES=1 if you "
                "trust the file"
            )
            return REFUSED
        stage = Usd.Stage.Open(file)
    except Tf.ErrorException as error:
        # Opening it in another process could take the memory that is missing here.
        print(f"is not a readable USD file: {_reason(error)}")
        return REFUSED
    for count, prim in enumerate(
        Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    ):
        if count >= most_prims:
            print(f"it has more than {most_prims} prims")
            return REFUSED
        for attribute in prim.GetAuthoredAttributes():
            fault = _fault(attribute)
            if fault:
                print(fault)
                return REFUSED
    return 0


def _outside(file: str, folders: list[str]) -> str:
    """Return the first path outside the folders that the file or a layer which it refers to names; empty if none."""
    waiting, known = [file], {file}
    while folders and waiting:
        layer = Sdf.Layer.FindOrOpen(waiting.pop())
        for asset in _named_layers(layer) if layer else ():
            # In a package, the path of a part follows that of the package.
            path = layer.ComputeAbsolutePath(asset)
            outer = Path(Ar.SplitPackageRelativePathOuter(path)[0])
            if not any(outer.resolve().is_relative_to(folder) for folder in folders):
                return ascii(asset)
            if path not in known:
                known.add(path)
                waiting.append(path)
    return ""


def _named_layers(layer: Sdf.Layer) -> set[str]:
    """Return the layers that a layer names: sublayers, references, payloads and value clips."""
    found = set(layer.GetCompositionAssetDependencies())

    def add_clips(path: Sdf.Path) -> None:
        is_prim = path.IsPrimPath() or path.IsPrimVariantSelectionPath()
        spec = layer.GetPrimAtPath(path) if is_prim else None
        for clips in (spec.GetInfo("clips") or {}).values() if spec else ():
            stated = [
                clips.get(key) for key in ("manifestAssetPath", "templateAssetPath")
            ]
            found.update(
                asset.path if isinstance(asset, Sdf.AssetPath) else asset
                for asset in stated
                if asset
            )
            found.update(asset.path for asset in clips.get("assetPaths") or ())

    layer.Traverse(Sdf.Path.absoluteRootPath, add_clips)
    return found


def _fault(attribute: Usd.Attribute) -> str:
    """Return what is wrong with the values of an attribute, or nothing.

    USD also reports memory that is missing here as a value that it cannot read. Another process would take that memory.
    """
    try:
        codes = attribute.GetTimeSamples()
        if len(codes) > MOST_SAMPLES:
            return f"{attribute.GetPath()} has {len(codes)} time samples, the limit is {MOST_SAMPLES}"
        for code in (Usd.TimeCode.Default(), *codes):
            attribute.Get(code)
    except Tf.ErrorException as error:
        return f"a value cannot be read: {_reason(error)}"
    except UnicodeDecodeError:
        return ""
    return ""


def _reason(error: Tf.ErrorException) -> str:
    try:
        return str(error.args[0].commentary).strip()
    except UnicodeDecodeError:
        # The message quotes the file, which may contain any bytes.
        return "it holds bytes that are not UTF-8 text"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), sys.argv[3:]))
