"""The time loop of one impact."""

from collections.abc import Callable

import numpy as np

from ..plan.cost import CHUNK
from .ending import EndCriterion
from .exchange import Impact
from .heat import flow, release
from .recorder import Recorder
from .touching import Touching

Probe = Callable[[Impact], None]  # a function that is called after each chunk of steps


def advance_to_end(
    impact: Impact, ending: EndCriterion, recorder: Recorder, keep: Callable[[], None], probe: Probe | None
) -> None:
    """Advance an impact to its end. keep(): function that stores the state, called before each chunk of steps; probe(impact):
    function called after each chunk.

    Raises SolverError when a domain fails or the energy ledger does not close, StoreError when a file cannot be written.
    """
    end_time, adhesion = ending.end_time if ending.at == "time" else None, recorder.plan.adhesion
    while not ending.reached(impact.time):
        keep()
        dt = advance_chunk(impact, end_time)
        if adhesion.criterion == "exposure":
            touching = Touching(impact.domains)
            impact.expose(touching)
            impact.bond(touching)
        force, above, grip = float(impact.force[2]), recorder.is_above(impact), impact.grip
        if recorder.impact_plan.material.is_ceramic and grip == "free" and impact.force.any():
            grip = "embedded"
        ending.observe(impact.time, impact.sinking, force, grip, above, impact.dissipated)
        if ending.turned is not None:
            if adhesion.in_impact and adhesion.criterion != "exposure":
                impact.bond(Touching(impact.domains))
            if recorder.seen.greatest is None:
                recorder.record_greatest(impact)
        recorder.record(impact, dt, is_last=ending.reached(impact.time))
        if probe is not None:
            probe(impact)
    impact.ledger.check_closure()
    impact.check_contact()


def advance_chunk(impact: Impact, end_time: float | None = None) -> float:
    """Advance both domains by CHUNK steps; near end_time (s) by fewer and shorter steps. Returns the time step, s."""
    impact.search_bodies()
    dt, steps = impact.stable_time_step(), CHUNK
    if end_time is not None and impact.time + steps * dt > end_time:
        steps = max(1, int(np.ceil((end_time - impact.time) / dt - 1e-9)))
        dt = (end_time - impact.time) / steps
    impact.search_contacts(steps * dt)
    impact.advance(steps, dt)  # LAMMPS runs the steps; each step calls impact.exchange_forces
    flow(impact.domains, steps * dt)
    release(impact.domains, impact.bonds)
    return dt
