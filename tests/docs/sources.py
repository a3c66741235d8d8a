"""Where pages have their numbers from: modules, tables and scores of the product, by page."""

import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, is_dataclass
from functools import cache
from importlib import import_module

import gymnasium
import numpy as np
from numbers_of_pages import unit_of, values
from places import ROOT

from gauge_envs import variants
from gauge_envs.tools.transfer import justified_ranges

UNIT_FACTORS = {
    "%": 100.0,
    "mm": 1e3,
    "mm/s": 1e3,
    "ms": 1e3,
    "cm": 100.0,
    "degrees": math.degrees(1.0),
    "degree": math.degrees(1.0),
    "MB": 1e-6,
    "m": 1e-3,
}
"""Units of pages, over those in which the package keeps its values; lengths of recordings are in mm."""

SOURCES = tomllib.loads((ROOT / "tests/docs/sources.toml").read_text())


def numbers_in(value):
    """Yield the numbers in a value of the package, without signs."""
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        value = value.values()
    if isinstance(value, bool | str | type) or callable(value):
        return
    if isinstance(value, int | float | np.number):
        yield abs(float(value))
    elif hasattr(value, "__dict__") and not isinstance(value, type(math)):
        yield from numbers_in(vars(value))
    elif isinstance(value, Iterable):
        for one in value:
            yield from numbers_in(one)


@cache
def numbers_of(source):
    """Return the numbers of a source.

    Args:
        source: A number of a law, or that a test reads from the page; `conformance ENGINE`, `score ID PARAMETERS`,
            `change ID PARAMETERS PARAMETERS` of the aligned RMSE, `limit TASK`, `ranges ID`; a module, a class, or a
            file.
    """
    if isinstance(source, float):
        return (source,)
    kind, *words = source.split()
    if kind == "conformance":
        return tuple(conformance_numbers(*words))
    if kind == "score":
        return tuple(numbers_in(score(*words)))
    if kind == "change":
        name, first, second = words
        aligned = [score(name, one)["rmse_aligned"] for one in (first, second)]
        return (abs(aligned[0] - aligned[1]),)
    if kind == "limit":
        env = gymnasium.make(f"GAUGE/{words[0]}").unwrapped
        limit = env.limit
        floats = [one for one in vars(env).values() if isinstance(one, float)]
        return limit.value, limit.sigma, limit.sigma / limit.value, *floats
    if kind == "ranges":
        return tuple(numbers_in(justified_ranges(words[0]).ranges))
    if "/" in source:
        return values((ROOT / source).read_text())
    try:
        module = vars(import_module(f"gauge_envs.{source}"))
        return tuple(numbers_in([module[name] for name in module if name.isupper()]))
    except ModuleNotFoundError:
        name, _, constant = source.rpartition(".")
        value = getattr(import_module(f"gauge_envs.{name}"), constant)
        value = vars(value() if is_dataclass(value) else value)
        return tuple(numbers_in([one for one in value.values() if not callable(one)]))


def conformance_numbers(engine):
    """Yield results of the checks of an engine, how far they are off, and how many have each status."""
    text = (ROOT / "scoring" / "conformance.json").read_text()
    for column in json.loads(text)["columns"]:
        if column["backend"] != engine:
            continue
        findings = column["findings"].values()
        statuses = [finding["status"] for finding in findings]
        yield len(statuses)
        yield from map(statuses.count, set(statuses))
        yield sum(statuses.count(one) for one in ("fail", "error"))
        yield sum(statuses.count(one) for one in ("pass", "fail"))
        for finding in findings:
            measured, expected = finding.get("measured"), finding.get("expected")
            if measured is not None and expected is not None:
                yield from (abs(measured), abs(expected))
                if expected:
                    yield abs(1.0 - measured / expected)


@cache
def score(name, parameters="calibrated"):
    """The score of an experiment in MuJoCo with default settings, and what its parts are."""
    env = gymnasium.make(f"GAUGE/{name}", parameters=parameters)
    env.reset(seed=0)
    is_over = False
    while not is_over:
        *_, terminated, truncated, info = env.step(0)
        is_over = terminated or truncated
    found = info["score"]
    return {
        **asdict(found),
        "a real trial": found.rmse / found.validation.rmse_normalized,
        "a real trial, aligned": found.rmse_aligned
        / found.validation.rmse_aligned_normalized,
        "release": found.rmse - found.rmse_aligned,
    }


def known(page, phrase):
    """Return the numbers that a page may have in a phrase with its unit."""
    named = [*SOURCES.get(page, ()), "scene.timing"]
    numbers = [one for source in named for one in numbers_of(source)]
    numbers += [0.95, len(variants())]
    unit = unit_of(phrase)
    factor = UNIT_FACTORS.get(unit, 1.0)
    found = [*numbers, *(factor * number for number in numbers)]
    if "1/" in phrase or unit in ("Hz", "samples"):
        found += [1.0 / number for number in numbers if number]
    return found
