"""The numerical schemes ("engines") of a particle, by their names in scenes."""

from .compiled import CompiledParticle
from .enriched import EnrichedParticle
from .machdyn import MachdynParticle
from .particle import Numerics, Particle

ENGINES: dict[str, type[Particle]] = {
    "compiled": CompiledParticle,
    "enriched": EnrichedParticle,
    "machdyn": MachdynParticle,
}


def engine(name: str, numerics: Numerics) -> type[Particle]:
    """The particle class of an engine. If hourglass control is requested (`numerics.control`), the enriched engine is replaced by the
    compiled one."""
    return CompiledParticle if name == "enriched" and numerics.control else ENGINES[name]
