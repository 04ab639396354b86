"""The engines of a particle, by the names that scenes give them."""

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
    """The class of a particle of this engine with these numerics: with hourglass control the enriched scheme is the compiled one."""
    return CompiledParticle if name == "enriched" and numerics.control else ENGINES[name]
