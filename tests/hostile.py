"""An installed package of faulty backends, each with one fault."""

from __future__ import annotations

SOURCE = '''
import ctypes, os, sys, time
from gauge_envs.backends import Backend
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo


def segfault():
    ctypes.string_at(0)


def say():
    print("a line of the engine")
    ctypes.CDLL(None).printf(b"a line of C code\\n")


class Engine(BackendMuJoCo):
    """MuJoCo backend that builds its worlds sequentially with `build`."""

    build_worlds = Backend.build_worlds


class Well(Engine):
    name = "well"


def at_import():
    raise SystemExit(3)


class SupportsCrash(Engine):
    name = "supports-crash"

    def supports(self, scene):
        segfault()


class SupportsHang(Engine):
    name = "supports-hang"

    def supports(self, scene):
        time.sleep(1000)


class Talking(Engine):
    name = "talking"

    def supports(self, scene):
        say()
        return super().supports(scene)

    def compiled(self, scene, *rest):
        say()
        return super().compiled(scene, *rest)


class NoJson(Engine):
    name = "no-json"

    def compiled(self, scene, *rest):
        simulation = super().compiled(scene, *rest)
        simulation.settings = {**simulation.settings, "pool": {1, 2}}
        return simulation


def fails_on_plastic(backend_name, fail):
    """Backend that calls a function in the episode of one scene."""

    class Stepped(SimulationMuJoCo):
        def reset(self, starts=None, seed=0):
            if 0.1469 in self.model.body_mass.round(6):
                fail()
            super().reset(starts, seed)

    class Failing(Engine):
        name = backend_name

        def compiled(self, scene, *rest):
            simulation = super().compiled(scene, *rest)
            simulation.__class__ = Stepped
            return simulation

    return Failing


Crash = fails_on_plastic("crash", segfault)
Exit = fails_on_plastic("exit", lambda: sys.exit(5))
HardExit = fails_on_plastic("hard-exit", lambda: os._exit(6))
Hang = fails_on_plastic("hang", lambda: time.sleep(1000))


def fails_on_contact(backend_name, fail):
    """A backend that calls a function while it builds a scene with contacts."""

    class Failing(Engine):
        name = backend_name

        def compiled(self, scene, *rest):
            if scene.contacts:
                fail()
            return super().compiled(scene, *rest)

    return Failing


ContactCrash = fails_on_contact("contact-crash", segfault)
ContactExit = fails_on_contact("contact-exit", lambda: sys.exit(5))
ContactHang = fails_on_contact("contact-hang", lambda: time.sleep(1000))
ContactGreedy = fails_on_contact("contact-greedy", lambda: (bytearray(10**9), time.sleep(1000)))


Greedy = fails_on_plastic("greedy", lambda: (bytearray(10**9), time.sleep(1000)))
'''

BACKENDS = {
    "well": "Well",
    "at-import": "at_import",
    "supports-crash": "SupportsCrash",
    "supports-hang": "SupportsHang",
    "talking": "Talking",
    "no-json": "NoJson",
    "crash": "Crash",
    "exit": "Exit",
    "hard-exit": "HardExit",
    "hang": "Hang",
    "greedy": "Greedy",
    "contact-crash": "ContactCrash",
    "contact-exit": "ContactExit",
    "contact-hang": "ContactHang",
    "contact-greedy": "ContactGreedy",
}


def install(folder, *names):
    """Install some of the backends in a folder on the import path."""
    (folder / "hostile_engines.py").write_text(SOURCE)
    info = folder / "hostile_engines-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: hostile-engines\nVersion: 1.0\n"
    )
    lines = [f"{name} = hostile_engines:{BACKENDS[name]}" for name in names]
    (info / "entry_points.txt").write_text(
        "\n".join(["[gauge_envs.backends]", *lines, ""])
    )
