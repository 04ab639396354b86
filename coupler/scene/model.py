"""The data of a scene. Derived values are in `coupler.plan.derived`.

Texts are limited to safe characters, because some are passed to solvers that can run commands.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator

from . import tables
from .coating import Coating
from .effects import requested
from .ground import Substrate
from .spray import GasConditions, Spray
from .values import Section

MOST_IMPACTS = 500


class SceneData(Section):
    """All tables of a scene, in SI units. `coupler.plan.reading.Scene` reads and checks them."""

    name: str = Field("scene", pattern=r"^[A-Za-z0-9][A-Za-z0-9_. -]{0,63}$")
    preset: Literal["draft", "standard", "fine"] = "standard"
    effects: str | list[str] = "auto"
    strength: str | None = Field(None, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$")
    library: str | None = None
    particles: list[tables.Particle] = Field(alias="particle")
    coating: Coating | None = None
    gas: GasConditions | None = None
    spray: Spray | None = None
    substrate: Substrate
    contact: tables.Contact = tables.Contact(friction=0.5)
    adhesion: tables.AdhesionTable = tables.AdhesionTable()
    splat: tables.SplatTable = tables.SplatTable()
    resolution: tables.Resolution = tables.Resolution()
    end: tables.End = tables.End()
    output: tables.Output = tables.Output()
    materials: dict[str, dict[str, object]] = Field(default_factory=dict)
    nozzles: dict[str, dict[str, object]] = Field(default_factory=dict)

    @field_validator("particles", mode="before")
    @classmethod
    def _in_order(cls, value: object) -> object:
        if not isinstance(value, list):
            return [value]
        if not value:
            raise ValueError(
                "is an empty list: give a table [particle], or one table [[particle]] for each of several impacts"
            )
        if len(value) > MOST_IMPACTS:
            raise ValueError(f"has {len(value)} impacts; at most {MOST_IMPACTS} are possible")
        return value

    @field_validator("effects", mode="before")
    @classmethod
    def _known_effects(cls, value: object) -> object:
        requested(value)  # raises ValueError
        return value

    @property
    def particle(self) -> tables.Particle:
        """The first particle of the scene."""
        return self.particles[0]

    @property
    def labels(self) -> list[str]:
        """Names of the particles in messages: "particle" for a single particle, otherwise "particle[1]" and so on."""
        n = len(self.particles)
        return ["particle"] if n == 1 else [f"particle[{i}]" for i in range(1, n + 1)]


def particle_tables(raw: Mapping[str, object]) -> list[dict[str, object]]:
    """The tables of the particles in a scene of nested dicts, without values of other types."""
    particles = raw.get("particle")
    return [each for each in (particles if isinstance(particles, list) else [particles]) if isinstance(each, dict)]


def safe_name(source: str) -> str:
    """The stem of a file name with only letters, digits, '_', '.', '-' and spaces; other characters become '_'."""
    stem = re.sub(r"[^A-Za-z0-9_. -]", "_", Path(source).stem, flags=re.ASCII)[:64].lstrip("_. -")
    return stem or "scene"
