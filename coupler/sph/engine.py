"""The engines of a particle, by the names that scenes give them."""

from .compiled import CompiledParticle
from .enriched import EnrichedParticle
from .machdyn import MachdynParticle
from .particle import Particle

ENGINES: dict[str, type[Particle]] = {
    "compiled": CompiledParticle,
    "enriched": EnrichedParticle,
    "machdyn": MachdynParticle,
}
