"""Arrays on a pretended device, which count and refuse every copy to the host, and an engine that has such arrays."""

import operator
from types import SimpleNamespace

import numpy as np

from gauge_envs.backends.device import DeviceWorlds, HostArrays
from gauge_envs.backends.worlds import ArrayWorlds
from gauge_envs.envs.device import dynamic_states

COMMON = (
    *("abs", "atan2", "broadcast_to", "clip", "concat", "cos", "einsum", "isfinite"),
    *("matmul", "sin", "sqrt", "square", "stack", "where", "zeros_like"),
)
"""What `DeviceWorlds.arrays` promises that environments use."""


class Refusing:
    """An array whose values only `values_of` reads."""

    __array_ufunc__ = None
    copies = 0

    def __init__(self, values):
        self._values = values

    @property
    def shape(self):
        return self._values.shape

    def __len__(self):
        return len(self._values)

    def __getitem__(self, key):
        return Refusing(self._values[_inner(key)])

    def __invert__(self):
        return Refusing(~self._values)

    def __neg__(self):
        return Refusing(-self._values)

    def reshape(self, shape):
        return Refusing(self._values.reshape(shape))

    def all(self, axis):
        return Refusing(self._values.all(axis=axis))

    def sum(self, axis):
        return Refusing(self._values.sum(axis=axis))

    def _refused(self, *_, **__):
        Refusing.copies += 1
        raise AssertionError("an array was copied to the host")

    __array__ = __float__ = __int__ = __bool__ = __index__ = __iter__ = _refused
    __dlpack__ = tolist = item = numpy = cpu = _refused


def _operator(function, *, swapped=False):
    def apply(self, other):
        pair = (self._values, _inner(other))
        return Refusing(function(*(reversed(pair) if swapped else pair)))

    return apply


for _name in ["add", "sub", "mul", "truediv", "and_", "or_", "lt", "le", "gt", "ge"]:
    _public = _name.rstrip("_")
    setattr(Refusing, f"__{_public}__", _operator(getattr(operator, _name)))
    setattr(
        Refusing, f"__r{_public}__", _operator(getattr(operator, _name), swapped=True)
    )


def _inner(given):
    if isinstance(given, Refusing):
        return given._values
    if isinstance(given, list | tuple):
        return type(given)(map(_inner, given))
    return given


def values_of(given):
    """Return the values of arrays, for the assertions of a test."""
    if isinstance(given, dict):
        return {name: values_of(one) for name, one in given.items()}
    return _inner(given)


def _function(name):
    """Return NumPy's function for these arrays."""

    def call(*arguments, **keywords):
        return Refusing(getattr(np, name)(*map(_inner, arguments), **keywords))

    return call


class Drifting(DeviceWorlds):
    """Bodies that accelerate as the driven body and the motors of their world move: worlds without physics."""

    arrays, name = (
        SimpleNamespace(**{one: _function(one) for one in COMMON}),
        "pretended:0",
    )

    def __init__(self, scenes):
        self._bodies = {body.name: row for row, body in enumerate(scenes[0].bodies)}
        self._dynamic = [body.name for body in scenes[0].dynamic_bodies]
        self._rests = {
            body.name: self.asarray(
                np.tile(
                    [*body.pose.position_m, *body.pose.quaternion, *[0.0] * 6],
                    (len(scenes), 1),
                )
            )
            for body in scenes[0].bodies
        }
        self._starts = self.asarray(
            np.stack([dynamic_states(scene) for scene in scenes])
        )

    def asarray(self, values):
        return values if isinstance(values, Refusing) else Refusing(np.asarray(values))

    def begin(self, states):
        states = self._starts if states is None else states
        self._states = dict(self._rests)
        self._states |= {name: states[:, row] for row, name in enumerate(self._dynamic)}
        self._push = 0.0

    def drive(self, body, motions):
        self._states[body] = motions[:, :13]
        self._push = motions[:, 13:16] + motions[:, 7:10]

    def command(self, values):
        self._push = values[:, :1]

    def advance(self, seconds):
        for name in self._dynamic:
            old = self._states[name]
            speed = old[:, 7:10] + seconds * self._push
            place = old[:, :3] + seconds * speed
            self._states[name] = self.arrays.concat(
                [place, old[:, 3:7], speed, old[:, 10:]], axis=1
            )

    def body_states(self, names):
        return self.arrays.stack([self._states[name] for name in names], axis=1)


class DriftingOnHost(HostArrays, Drifting):
    """The same in NumPy."""


class DriftingWorlds(ArrayWorlds):
    """The same as worlds of an engine."""

    def __init__(self, scenes):
        super().__init__({}, len(scenes))
        self._inner, self._scenes = DriftingOnHost(scenes), scenes
        self.reset(0)

    def reset(self, seed):
        self._inner.begin(None)

    def advance(self, seconds):
        self._inner.advance(seconds)

    def drive(self, body, motions, numbers):
        self._inner.drive(body, motions)

    def body_states(self, names):
        return self._inner.body_states(names)

    def on_device(self):
        return Drifting(self._scenes)

    def close(self):
        pass
