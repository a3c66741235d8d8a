"""Run commands on full disks, where nobody may write, at wrong times, with edited plans and under signals.

No command may print a traceback, leave a half-written file or a process behind, or lose an episode. The last part plays
`--episodes` episodes of cheap ids in one process and prints how memory, file descriptors and temporary files grow. It
needs Linux, and root to mount a small disk. Example:

    python studies/robustness/adversity.py --episodes 2000
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import gymnasium

import gauge_envs  # noqa: F401  (registers the ids)

START = "from gauge_command import main; main()"
LATE = f"import time; real = time.time; time.time = lambda: real() + 1e9; {START}"
EARLY = f"import time; real = time.time; time.time = lambda: real() - 1e9; {START}"
FAST = (
    *(
        f"SlopeSlider-{task}-{material}"
        for task in "12"
        for material in ("wood", "plastic")
    ),
    "BouncingBall-rubber",
)
SWEEP = ("sweep", "backends=mujoco", "variants=SlopeSlider-2-*", "--workers", "1")
VECTOR = """
import sys, gymnasium, gauge_envs
env = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=4, vectorization_mode=sys.argv[1])
env.reset(seed=0)
print("ready", flush=True)
while True:
    env.step(env.action_space.sample())
"""
ENDED_S = 20.0
"""Time in which a process must end after a signal [s]."""


def gauge(
    *arguments: object, start: str = START, **limits: int
) -> subprocess.CompletedProcess[str]:
    """Run a command, with limits of its process by the names of `resource`, as `RLIMIT_FSIZE=1000`."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        for name, value in limits.items():
            resource.setrlimit(getattr(resource, name), (value, value))

    command = [sys.executable, "-c", start, *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, preexec_fn=limit, check=False
    )


def checked(
    what: str,
    done: subprocess.CompletedProcess[str],
    codes: tuple[int, ...],
    folder: Path,
) -> None:
    """Print the end of a command, and raise an error if it is not one for people."""
    last = (done.stderr.strip() or done.stdout.strip() or "-").splitlines()[-1]
    print(f"{what}: exit code {done.returncode}, {last[:110]!r}")
    assert done.returncode in codes, done.stderr
    assert "Traceback" not in done.stderr + done.stdout, done.stderr
    left = [str(file) for file in folder.rglob(".*.tmp")] if folder.is_dir() else []
    assert not left, left


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """Mount a disk of some kB, which ends with the context."""
    folder.mkdir()
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", folder], check=True
    )
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def disks(folder: Path) -> None:
    """Fill disks, and write where nobody may."""
    checked(
        "run", gauge("run", *FAST[:2], "--out", folder / "good"), (0,), folder / "good"
    )
    for size in ("4k", "16k", "64k"):
        with small_disk(folder / f"full-{size}", size) as place:
            for command in (
                ("run", *FAST[:3], "--out", place / "out"),
                (*SWEEP, "--out", place / "sweep"),
            ):
                checked(
                    f"{command[0]} on a disk of {size}",
                    gauge(*command),
                    (0, 1, 2),
                    place,
                )
            name = ("report", folder / "good", "--out", place / "site")
            checked(f"report on a disk of {size}", gauge(*name), (0, 1, 2), place)
    with small_disk(folder / "read-only", "1m") as place:
        subprocess.run(["mount", "-o", "remount,ro", place], check=True)
        for command in (("run", *FAST[:2]), SWEEP):
            checked(
                f"{command[0]} on a read-only disk",
                gauge(*command, "--out", place / "out"),
                (1, 2),
                place,
            )
    checked(
        "run with files of at most 1000 bytes",
        gauge("run", *FAST[:2], "--out", folder / "small", RLIMIT_FSIZE=1000),
        (1, 2),
        folder / "small",
    )
    for place in ("/proc/out", "/dev/null/out", "/dev/full"):
        checked(
            f"run into {place}", gauge("run", FAST[0], "--out", place), (1, 2), folder
        )


def clocks(folder: Path) -> None:
    """Go on with a sweep whose clock went 32 years back or forth: nothing runs twice."""
    checked("sweep", gauge(*SWEEP, "repeats=2", "--out", folder), (0,), folder)
    before = {file.name: file.read_bytes() for file in folder.glob("*.json")}
    for what, start in (("late", LATE), ("early", EARLY)):
        checked(
            f"sweep at a time too {what}",
            gauge(*SWEEP, "repeats=3", "--out", folder, start=start),
            (0,),
            folder,
        )
        assert (
            before.items()
            <= {file.name: file.read_bytes() for file in folder.glob("*.json")}.items()
        )
    for file in folder.glob("*.json"):
        os.utime(file, (4e9, 4e9))
    checked(
        "sweep of files from the future",
        gauge(*SWEEP, "repeats=3", "--out", folder),
        (0,),
        folder,
    )
    assert len(list(folder.glob("*.json"))) == 9


def edited_plan(folder: Path) -> None:
    """Edit the file of a sweep while it runs, kill it, and go on: results of both plans stay whole."""
    plan, out = folder / "plan.toml", folder / "out"
    plan.write_text(
        'backends = ["mujoco"]\nvariants = ["SlopeSlider-2-*"]\nrepeats = 20\n'
    )
    command = [
        sys.executable,
        "-c",
        START,
        "sweep",
        str(plan),
        "--workers",
        "1",
        "--out",
        str(out),
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while len(list(out.glob("*.json"))) < 5 and process.poll() is None:
        time.sleep(0.02)
    plan.write_text(
        'backends = ["mujoco"]\nvariants = ["SlopeSlider-2-wood"]\nrepeats = 4\nseed = 100\n'
    )
    process.kill()
    process.wait()
    before = {file.name: file.read_bytes() for file in out.glob("*.json")}
    done = gauge("sweep", plan, "--workers", "1", "--out", out)
    checked("sweep with an edited plan", done, (0,), out)
    after = {file.name: file.read_bytes() for file in out.glob("*.json")}
    assert before.items() <= after.items() and len(after) == len(before) + 4, (
        len(before),
        len(after),
    )
    plan.write_text("backends = 3")
    checked("sweep with a damaged plan", gauge("sweep", plan, "--out", out), (2,), out)


def signals() -> None:
    """Interrupt, end and kill vector environments: no process is left."""
    # A shell ignores Ctrl-C for what it starts in the background, and so would the children.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for mode in ("sync", "async", "vector_entry_point"):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            process = subprocess.Popen(
                [sys.executable, "-c", VECTOR, mode],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            assert process.stdout is not None and process.stdout.readline() == "ready\n"
            group = _descendants(process.pid)
            process.send_signal(number)
            start = time.monotonic()
            process.wait(ENDED_S)
            while (
                left := [pid for pid in group if Path(f"/proc/{pid}").exists()]
            ) and _since(start) < ENDED_S:
                time.sleep(0.05)
            print(
                f"{mode} vector of 4 under {number.name}: {len(group)} children ended in {_since(start):.2f} s"
            )
            assert not left, left


def _since(start: float) -> float:
    return time.monotonic() - start


def _descendants(pid: int) -> list[int]:
    children = [
        int(one)
        for file in Path(f"/proc/{pid}/task").glob("*/children")
        for one in file.read_text().split()
    ]
    return [*children, *(inner for child in children for inner in _descendants(child))]


def episodes(count: int, seed: int, folder: Path) -> None:
    """Play episodes of mixed ids and engines, each in an environment of its own, and print what grows."""
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
    chance = random.Random(seed)
    marks = {round(count * share) for share in (0.1, 0.25, 0.5, 0.75, 1.0)}
    start_s = time.process_time()
    for number in range(1, count + 1):
        env = gymnasium.make(
            f"GAUGE/{chance.choice(FAST)}", backend=chance.choice(("mujoco", "rapier"))
        )
        env.reset(seed=number)
        over = False
        while not over:
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            over = terminated or truncated
        env.close()
        if number in marks:
            status = dict(
                line.split(":", 1)
                for line in Path("/proc/self/status").read_text().splitlines()
            )
            files = len(list(Path("/proc/self/fd").iterdir()))
            temporary = len(list(folder.iterdir()))
            memory = int(status["VmRSS"].split()[0]) / 1e3
            used_s = time.process_time() - start_s
            print(
                f"{number} episodes: {memory:.1f} MB, {files} files, {temporary} temporary, {used_s:.0f} s",
                flush=True,
            )


def main() -> None:
    """Run all parts, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "parts", nargs="*", default=["disks", "clocks", "plan", "signals", "episodes"]
    )
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        parts = {
            "disks": disks,
            "clocks": clocks,
            "plan": edited_plan,
            "signals": lambda _: signals(),
            "episodes": lambda folder: episodes(given.episodes, given.seed, folder),
        }
        for part in given.parts:
            folder = Path(place) / part
            folder.mkdir()
            parts[part](folder)


if __name__ == "__main__":
    main()
