"""Define what a language does: it writes changes of settings as a target states them, so that they can be pasted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar


class Language(ABC):
    """Language in which a target states its settings.

    Attributes:
        name: Name that a `TrainingConfiguration` refers to.
    """

    name: ClassVar[str]

    def writes(self, name: str) -> bool:
        """Return whether a target can state a setting; others are not changed in the search for causes and cures.

        Args:
            name: Name of the backend's setting.
        """
        return True

    @abstractmethod
    def assignment(self, name: str, value: Any) -> str:
        """Return one setting of a backend with its value as the target writes it.

        Args:
            name: Name of the backend's setting.
            value: Its value; None for a setting that is to be left out.
        """

    @abstractmethod
    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return changes of settings as text that can be pasted into the target.

        Args:
            changes: New values by name of the backend's setting.
            geoms: Geoms that the contact constants belong to, when there are several sets; empty for all geoms.
        """

    @abstractmethod
    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return a gravity [m/s^2], shape [3], as text that can be pasted into the target."""

    def value_text(self, name: str, value: Any) -> str:
        """Return the value of a setting alone, as the target writes it."""
        if value is None:
            return "the default of the engine"
        return self.assignment(name, value).partition("=")[2].strip().strip('"')


def number_text(value: Any) -> str:
    """Return a number with six digits at most."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
