"""The verdict on a particle: what it says, what it rests on, and that one particle and several are judged alike."""

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from runs import SharedRuns
from scenes import SHORT, TINY, scene, scene_with, several
from sheet import ENERGY, SIDE, Sheet

from coupler import Scene
from coupler.contact.particle_bonds import ParticleBonds
from coupler.errors import SceneError
from coupler.impact.verdict import Verdict, judge
from coupler.physics.adhesion import Adhesion, PairFormula, critical_velocity
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.report.screen import screen
from coupler.report.words import remarks
from coupler.report.words import verdict as in_words

COHESIVE = Adhesion(kind="cohesive", strength=4e8, energy=ENERGY)
WHOLE = ENERGY * SIDE**2  # J
MASS = 1e-13  # kg
IMPACT = plan(scene_with()).impact


def opened(lift: float) -> Sheet:
    sheet = Sheet(4)
    for s in np.linspace(0.0, lift, 500)[1:]:
        sheet.move(sheet.xp + np.array([0.0, 0.0, s]))
    return sheet


def test_a_particle_sticks_while_its_bonds_can_take_up_more_than_is_left() -> None:
    bonds = opened(0.1e-6).bonds
    left = bonds.resistance - bonds.bond.stored
    assert 0.1 * WHOLE < left < WHOLE
    limit = math.sqrt(2.0 * left / MASS)
    for share in (0.5, 0.99, 1.01, 2.5):
        found = judge(COHESIVE, IMPACT, MASS, share * limit, bonds)
        # far above the limit it leaves: bonds take up a quarter of its energy
        assert found.bonds == ("sticks" if share < 1.0 else "undecided" if share < 2.0 else "rebounds")
        if share < 1.0:
            assert found.margin_J == pytest.approx(left * (1.0 - share**2))
            assert found.margin_m_s == pytest.approx(limit * math.sqrt(1.0 - share**2))
    assert judge(COHESIVE, IMPACT, MASS, -0.5 * limit, bonds).bonds == "sticks"


def test_a_particle_that_hangs_on_a_point_is_undecided() -> None:
    sheet = Sheet(4)
    for s in np.linspace(0.0, 1.0, 500)[1:]:  # peeled off all but the row at the edge
        to = sheet.xp.copy()
        to[3:, 2] += s * 1e-6
        sheet.move(to)
    bonds = sheet.bonds
    assert np.count_nonzero(~bonds.bond.broken) == 3
    assert judge(COHESIVE, IMPACT, MASS, 0.0, bonds).bonds == "sticks"
    bonds.bond.damage[0] = 1.0
    found = judge(COHESIVE, IMPACT, MASS, 0.0, bonds)
    assert found.verdict == "undecided"
    assert found.rests_on.startswith("only 2 of 16 bonds hold")
    assert found.rebounded is None


def test_a_margin_within_the_scatter_is_named() -> None:
    """Rebound with an energy about half of what the bonds have dissipated."""
    bonds = opened(1e-6).bonds
    spent = bonds.bond.dissipated
    assert spent == pytest.approx(WHOLE, rel=0.02)
    for share, is_close in ((0.45, True), (0.55, False)):
        found = judge(COHESIVE, IMPACT, MASS, math.sqrt(2.0 * share * spent / MASS), bonds)
        assert (found.bonds, found.is_close) == ("rebounds", is_close)
        assert ("other positions of points" in found.rests_on) == is_close
    assert not judge(COHESIVE, IMPACT, MASS, 20.0, None).is_close


def test_nothing_that_holds_and_no_motion_is_no_verdict() -> None:
    torn = opened(1e-6).bonds
    for law, bonds in ((COHESIVE, None), (COHESIVE, torn), (Adhesion(), None)):
        left = judge(law, IMPACT, MASS, 20.0, bonds)
        assert (left.verdict, left.margin_m_s) == ("rebounds", -20.0)
        assert left.margin_J == pytest.approx(-0.5 * MASS * 400.0)
        assert left.by == ("bonds" if law.in_impact else "motion")
        assert judge(law, IMPACT, MASS, 0.3, bonds).verdict == "undecided"


@pytest.mark.parametrize(
    ("metal", "angle", "expected"), [("Ni", 0.0, "rebounds"), ("OFHC_Cu", 0.0, "sticks"), ("OFHC_Cu", 60.0, "rebounds")]
)
def test_the_default_compares_the_normal_velocity_with_the_critical_one(
    metal: str, angle: float, expected: str
) -> None:
    """The same for one particle and for two; the component along the surface does not count."""
    critical = critical_velocity(material(metal), 300.0)
    changes = {
        "material": metal,
        "angle": f"{angle} deg",
        "velocity": f"{1.23 * critical if metal != 'Ni' else 500.0} m/s",
    }
    one = plan(scene_with(**{f"particle__{k}": v for k, v in changes.items()} | {"substrate__material": metal}))
    two = plan(several(changes, changes))
    for planned, impact in ((one, one.impact), (two, two.impacts[1])):
        found = judge(planned.adhesion, impact, MASS, 20.0, None)
        assert found.verdict == expected
        assert found.margin_m_s == pytest.approx(-impact.velocity[2] - critical)
        assert "Schmidt" in found.rests_on
        assert found.by == "formula"


def test_the_default_verdict_is_that_of_the_pair_or_says_that_it_is_not() -> None:
    """Copper at 500 m/s on four metals and itself: its formula alone says that it sticks, by 12 m/s, to all."""

    def sentence(base: str) -> tuple[str, str]:
        planned = plan(scene_with(particle__material="Cu", substrate__material=base))
        found = judge(planned.adhesion, planned.impact, MASS, 20.0, None)
        assert found.rebounded is False  # the run ties it by the formula of copper
        return found.verdict, found.rests_on

    said = {base: sentence(base) for base in ("Cu", "SS304", "Al", "W", "V")}
    assert len(set(said.values())) == 5
    assert said["Cu"][0] == said["V"][0] == "sticks"
    assert "the metal of the substrate is not considered (V has no tensile strength sigma_TS)" in said["V"][1]
    for base in ("SS304", "Al", "W"):
        verdict, words = said[base]
        assert verdict == "undecided"
        assert f"({base}): the results for the two metals disagree" in words


def test_bonds_and_formula_that_disagree_are_both_said() -> None:
    """Copper of 30 um on 6061 at 614 m/s: its formula says 473 m/s, and the bonds are torn. On itself at 450 m/s both say rebound, at
    614 m/s bonds that hold and the formula say that it sticks."""
    torn, whole = opened(1e-6).bonds, opened(0.1e-6).bonds

    def found(base: str, velocity: float, bonds: ParticleBonds, upwards: float) -> Verdict:
        changes = {"particle__material": "Cu", "particle__diameter": "30 um", "particle__velocity": f"{velocity} m/s"}
        return judge(COHESIVE, plan(scene_with(**changes, substrate__material=base)).impact, MASS, upwards, bonds)

    split = found("Al", 614.0, torn, 20.0)
    assert (split.verdict, split.bonds, split.rebounded) == ("undecided", "rebounds", True)
    assert split.rests_on.startswith(
        "it rebounds by computed bonds (all bonds are torn, it leaves the target at 20 m/s; the margin is so small"
    )
    assert "critical 473 m/s (OFHC_Cu) and" in split.rests_on
    own = found("Cu", 614.0, torn, 20.0)
    assert own.verdict == "undecided"
    assert "it rebounds by computed bonds" in own.rests_on
    assert "by the formula it sticks" in own.rests_on
    for velocity, bonds, upwards, verdict in ((450.0, torn, 20.0, "rebounds"), (614.0, whole, 0.0, "sticks")):
        agreed = found("Cu", velocity, bonds, upwards)
        assert agreed.verdict == agreed.bonds == verdict
        assert f"it {verdict} by the formula, too" in agreed.rests_on


def test_a_metal_without_a_formula_is_judged_by_its_bonds_and_named() -> None:
    impact = plan(scene_with(particle__material="V")).impact
    found = judge(COHESIVE, impact, MASS, 20.0, opened(1e-6).bonds)
    assert found.verdict == found.bonds == "rebounds"
    assert found.rests_on.endswith("no formula: the critical velocity of V is not known")


def test_ties_of_the_scene_are_named_as_its_assumption() -> None:
    found = judge(Adhesion(kind="tied"), IMPACT, MASS, 20.0, None)
    assert (found.verdict, found.margin_J) == ("sticks", None)
    assert found.rests_on.startswith("the scene")


def test_the_verdict_in_words() -> None:
    record = {"verdict": "sticks", "verdict_rests_on": "bonds", "margin_m_s": 12.34, "verdict_criterion": "tied"}
    assert in_words({"impacts": [record]}) == ["sticks: bonds; margin +12.3 m/s (adhesion: tied)"]
    assert in_words({}) == []
    computed = record | {"bonded_area_m2": 120e-12, "bonded_area_end_m2": 98.7e-12}
    assert in_words({"impacts": [computed]})[0].startswith(
        "sticks: bonds; margin +12.3 m/s; bonded area 120 µm², 98.7 µm² at the end"
    )


def test_a_few_verdicts_have_a_line_each() -> None:
    base = {"verdict_criterion": "tied, by velocity", "verdict_by": "formula", "particle_mass_kg": 1e-13}
    records: list[dict[str, Any]] = [
        base | {"verdict": "sticks", "verdict_rests_on": "formula A", "margin_m_s": 12.0},
        base | {"verdict": "rebounds", "verdict_rests_on": "formula B", "margin_m_s": -165.0},
        base | {"verdict": "undecided", "verdict_rests_on": "it sinks", "margin_m_s": None},
    ]
    assert in_words({"impacts": records}) == [
        "of 3 particles 1 sticks, 1 rebounds, 1 is undecided (adhesion: tied, by velocity)",
        "particle 1 sticks: formula A; margin +12 m/s",
        "particle 2 rebounds: formula B; margin -165 m/s",
        "particle 3 is undecided: it sinks",
    ]
    records[0]["detached_mass_kg"] = 1e-13
    head, first, *_ = in_words({"impacts": records})
    assert "particle 1 sticks at its impact and has come off later" in head
    assert first.startswith("particle 1 sticks at its impact and has come off later: formula A")
    records[0]["detached_mass_kg"] = 0.3e-13
    assert "parts of particle 1 have come off later" in in_words({"impacts": records})[0]


def test_many_verdicts_are_counted_by_what_decides_them_with_the_closest() -> None:
    """Nine by computed bonds with margins from +50 m/s down by 10, one by the formula at -3 m/s, one without an end."""
    records: list[dict[str, Any]] = [
        {"verdict": "sticks", "verdict_by": "bonds", "verdict_rests_on": f"bonds {k}", "margin_m_s": 130.0 - 10.0 * k}
        for k in range(9)
    ]
    records += [
        {"verdict": "rebounds", "verdict_by": "formula", "verdict_rests_on": "slow", "margin_m_s": -3.0},
        {"verdict": "undecided", "verdict_by": None, "verdict_rests_on": "time", "margin_m_s": None},
    ]
    for k in (1, 2, 3, 6, 10):
        records[k] |= {"particle_mass_kg": 1e-13, "detached_mass_kg": 1e-13}
    assert in_words({"impacts": records}) == [
        "of 11 particles 9 stick, 1 rebounds, 1 is undecided;"
        " particles 2 to 4, 7 stick at their impact and have come off later; particle 11 has come off after the impact",
        "verdicts: 9 by computed bonds, 1 by formula, 1 still in contact at the end",
        "smallest margin: particle 10 rebounds: slow; margin -3 m/s",
    ]


def test_the_verdict_stands_first_and_what_does_not_rebound_has_no_rebound_velocity(shared_run: SharedRuns) -> None:
    """Copper that its own formula ties, and that of steel does not; one whose run ends while it sinks."""
    tied = shared_run(scene(("OFHC_Cu", 25, 600), **TINY))
    (first,) = tied.impacts
    assert next(iter(first)) == "verdict"
    assert (first["verdict"], first["verdict_by"], first["rebounded"]) == ("undecided", "formula", False)
    assert first["end"]["velocity_z_m_s"] > 1.0
    for key in ("rebound_velocity_m_s", "restitution"):
        assert first[key] is None
        assert first["refused"][key] == first["verdict_rests_on"]
    assert not any("rebound velocity" in text for text in remarks(tied.summary))
    assert screen(tied).startswith(
        "verdict: undecided: Schmidt's formula: 600 m/s normal to the surface, critical 488 m/s (OFHC_Cu) and"
    )
    sinking = shared_run(SHORT)
    (last,) = sinking.impacts
    assert (last["verdict"], last["verdict_by"], last["undecided"]) == ("undecided", None, None)
    for key in ("rebound_velocity_m_s", "restitution", "rebounded"):
        assert last[key] is None
        assert last["refused"][key] == last["verdict_rests_on"] == "the particle is still in contact"
    assert re.search(r"rebound velocity +- ", screen(sinking)), screen(sinking)


def test_on_a_polymer_a_particle_stays_where_the_polymer_holds_it() -> None:
    """No bonds of metals form there: at rest with its centre below the surface it is embedded; what moves off rebounds, and what lies
    on the surface is undecided."""
    no_bonds, on_peek = Adhesion(kind="none"), replace(IMPACT, formula=PairFormula("Al", 600.0, "PEEK"))
    embedded = judge(no_bonds, on_peek, MASS, 0.1, None, sunk=3e-6)
    assert (embedded.verdict, embedded.rebounded) == ("embedded", False)
    assert "embedded in PEEK, a polymer: its centre lies 3 um below the surface" in embedded.rests_on
    assert judge(no_bonds, on_peek, MASS, 0.1, None, sunk=-3e-6).verdict == "undecided"
    left = judge(no_bonds, on_peek, MASS, 20.0, None, sunk=3e-6)
    assert left.verdict == "rebounds"
    assert "whose erosion is not modelled" in left.rests_on


def test_bonds_of_metals_do_not_apply_on_a_polymer() -> None:
    """By default there are none, and those by oxide films are refused with the reason."""
    text = SHORT.replace('"SS304"', '"PEEK"')
    assert Scene.from_text(text).derived.adhesion_law.kind == "none"
    with pytest.raises(SceneError, match="PEEK is a polymer: it has no oxide film"):
        Scene.from_text(text + '[adhesion]\nkind = "cohesive"\ncriterion = "exposure"\n')
    tied = Scene.from_text(text + '[adhesion]\nkind = "tied"\n')
    warned = [
        any("no bond of metals forms on PEEK" in words for words in plan(s).warnings)
        for s in (Scene.from_text(text), tied)
    ]
    assert warned == [True, False]
