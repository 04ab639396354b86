"""Each effect has its own switch and closed form; the numbers that decide; the range of the models."""

import math
from pathlib import Path

import numpy as np
import pytest
from conftest import elastic
from scenes import scene_with, several

from coupler import run
from coupler.fe import mesh as meshes
from coupler.fe.explicit import Target
from coupler.geometry import mesher
from coupler.impact.validity import Extreme, Extremes, greatest_compression, merged, pressure
from coupler.particle import law as points_law
from coupler.particle.model import State
from coupler.physics import constitutive as law
from coupler.physics.materials import material
from coupler.plan import effects
from coupler.plan.planning import plan
from coupler.scene.effects import NAMES


def test_conductivity_is_that_of_the_first_temperature_without_its_effect() -> None:
    metal = material("Ni")
    on, off = law.law_record(metal)[0], law.law_record(metal, {"temperature_dependent_k": False})[0]
    assert law.conductivity(on, 700.0) == pytest.approx(metal.k_at(700.0))
    assert law.conductivity(off, 700.0) == metal.k[0][1]
    without_cp = law.law_record(metal, {"temperature_dependent_cp": False})[0]
    assert law.heat_capacity(without_cp, 700.0) == metal.cp[0][1]
    assert law.conductivity(without_cp, 700.0) == law.conductivity(on, 700.0)


def test_heat_raises_temperature_by_enthalpy_and_softens_by_johnson_cook() -> None:
    metal = material("Ti")
    record = law.law_record(metal)[0]
    T = law.heated(record, 350.0, 1e5)
    slope = (metal.cp[1][1] - metal.cp[0][1]) / (metal.cp[1][0] - metal.cp[0][0])
    assert metal.cp_at(350.0) * (T - 350.0) + 0.5 * slope * (T - 350.0) ** 2 == pytest.approx(1e5, rel=1e-12)
    assert law.heated(record, T, -1e5) == pytest.approx(350.0, rel=1e-12)
    sigma = law.yield_stress(record, 0.2, 0.0, 350.0)
    assert law.softened(record, sigma, 0.2, 350.0, T) == pytest.approx(law.yield_stress(record, 0.2, 0.0, T), rel=1e-12)
    hard = law.law_record(metal, {"thermal_softening": False})[0]
    assert law.softened(hard, sigma, 0.2, 350.0, T) == sigma


@pytest.mark.parametrize("expands", [True, False])
def test_heat_makes_pressure_only_with_thermal_expansion(expands: bool) -> None:
    """Held in its volume a body gains Gamma0 times its heat in pressure; the ledger contains the heat."""
    metal = material("Ni")
    m = meshes.prepare(*mesher.box((1.0, 1.0, 1.0), 0.5))
    t = Target(
        m,
        law.law_record(metal, {"thermal_expansion": expands}),
        300.0,
        fixed=("bottom", "top", "sides"),
        track_wave=False,
    )
    t.warm(np.arange(len(m.conn)), 1e8 * m.V0)
    assert t.elements.T.min() > 320.0
    t.advance(1e-9)
    t.finish()
    np.testing.assert_allclose(t.nodes.p, metal.Gamma0 * 1e8 if expands else 0.0, rtol=1e-6, atol=1e-3)
    assert t.elastic() == pytest.approx(0.0, abs=1e-6 * 1e8)


def test_plastic_heat_stays_out_of_the_pressure_without_expansion() -> None:
    """A block sheared far: its energy is plastic work, and without expansion no mean stress comes of it."""
    metal = material("OFHC_Cu")
    pressures = []
    for on in (True, False):
        m = meshes.prepare(*mesher.box((1.0, 1.0, 1.0), 0.5))
        record = law.law_record(metal, {"thermal_expansion": on})
        faces = ("bottom", "top", "sides")
        t = Target(m, record, 300.0, fixed=faces, track_wave=False)
        t.inv_mass[:] = 0.0  # every node is driven
        t.nodes.v[:, 0] = 1e3 * m.points[:, 2]
        for _ in range(400):
            t.advance(1e-6)
            t.finish()
        assert t.elements.eps_p.min() > 0.1
        assert t.balance.heat == pytest.approx(0.9 * t.balance.plastic if on else 0.0, rel=1e-9)
        pressures.append((float(t.nodes.p.mean()), 0.9 * t.balance.plastic))
    assert pressures[0][0] == pytest.approx(metal.Gamma0 * pressures[0][1], rel=0.01)  # of a volume of 1 m3
    assert abs(pressures[1][0]) < 1e-6 * pressures[0][0]


def test_numbers_of_conduction_on_both_sides() -> None:
    made = plan(scene_with(particle__material="OFHC_Cu"))
    value = {row.name: row.value for row in made.decisions}
    copper, steel = material("OFHC_Cu"), material("SS304")
    time = made.impact.end_time
    in_points = math.sqrt(effects.diffusivity(copper, 300.0) * time) / made.impact.spacing
    assert value["particle_conduction"] == pytest.approx(in_points)
    # steel is the one that holds heat back
    across = math.sqrt(effects.diffusivity(steel, 300.0) * time) / made.target.element_size
    assert value["interface_conduction"] == pytest.approx(across)
    later = {row.name: row.value for row in plan(several(*[{"material": "OFHC_Cu"}] * 2)).decisions}
    assert later["particle_conduction"] == pytest.approx(in_points)  # a particle is there for its own impact only


def test_cooling_needs_a_pause_and_adhesion_is_the_same_for_one_and_for_several() -> None:
    alone = plan(scene_with(particle__dwell="1 ms"))
    assert alone.effects.adhesion
    short, long = (plan(several({"dwell": dwell}, {})) for dwell in ("1 ns", "1 ms"))
    assert (short.effects.cooling, long.effects.cooling) == (False, True)
    value = next(row.value for row in long.decisions if row.name == "cooling")
    assert value == pytest.approx(math.sqrt(effects.diffusivity(material("Ni"), 300.0) * 1e-3) / 25e-6)
    assert plan(several({}, {})).adhesion == alone.adhesion
    assert (alone.adhesion.kind, alone.adhesion.criterion) == ("tied", "velocity")
    assert plan(several({}, {}, effects=["auto", "-adhesion"])).adhesion.kind == "none"


def test_what_many_impacts_share_is_said_once() -> None:
    texts = [
        "note", "impact 1: rates went to 1.5e+08 1/s", "impact 2: rates went to 2.1e+09 1/s", "impact 2: over the rim",
        "impact 3: rates went to 9e+07 1/s", "note", "impact 3 failed at 3 ns: a", "impact 3 failed at 4 ns: a",
    ]  # fmt: skip
    assert merged(texts) == [
        "note", "impact 2: rates went to 2.1e+09 1/s (and less in 2 other impacts)", "impact 2: over the rim",
        "impact 3 failed at 3 ns: a", "impact 3 failed at 4 ns: a",
    ]  # fmt: skip
    named = [
        f"impact {k}: particle (4340, Johnson_1983) strain rate {rate} 1/s" for k, rate in ((1, "1e+06"), (2, "3e+06"))
    ]
    assert merged(named) == [f"{named[1]} (and less in 1 other impact)"]


def test_recovery_counts_the_time_of_the_closing_stage() -> None:
    """Copper loses nearly all its dislocations in 1e5 s at 600 K."""
    hot = {"temperature": "700 K", "material": "OFHC_Cu"}
    end = {"at": "cold", "ambient": "600 K"}
    with_time, without = (
        plan(
            several(
                hot, hot, substrate__material="OFHC_Cu", end=end | {"cooling_time": time}, adhesion={"kind": "tied"}
            )
        )
        for time in ("100000 s", "0 s")
    )
    assert (with_time.effects.recovery, without.effects.recovery) == (True, False)


def test_the_percentile_of_few_values_is_not_the_largest() -> None:
    """Of 1, 2 .. 50 the 99th percentile lies 0.99 x 49 places above the first value; zeros do not count."""
    kept, values = Extreme(), np.append(np.zeros(30), np.arange(1.0, 51.0))
    kept.note(values, values, 0.1 * values, np.ones(80))
    assert (kept.rate, kept.strain) == pytest.approx((49.51, 4.951), rel=1e-12)


def test_warnings_name_the_limit_that_was_left() -> None:
    from types import SimpleNamespace

    nickel, steel = material("Ni"), material("SS304")
    laws = law.law_record(nickel), np.concatenate([law.law_record(steel), law.law_record(material("Al"))])
    seen, steel_alone, both = Extremes(), np.array([True, False]), np.array([True, True])
    one = np.ones(200)

    def holding(**state: np.ndarray) -> SimpleNamespace:
        """Points and target of this state."""
        record = SimpleNamespace(**state)
        return SimpleNamespace(
            points=record, nodes=record, elements=record, active_nodes=200, active_elements=200, law=laws[0], laws=laws[1],
            law_of=(np.arange(200) > 190).astype(int), metals=SimpleNamespace(of_node=(np.arange(200) > 190).astype(int)),
        )  # fmt: skip

    at_rest = {"rate": 0.0 * one, "T": 300.0 * one, "J": one, "eps_p": 0.0 * one}
    calm = holding(**at_rest)
    seen.note(calm, calm, steel_alone)
    assert seen.warnings(1, {"particle": nickel, "target": steel}, True) == []
    wild = holding(rate=3e7 * one, T=0.95 * nickel.T_m * one, J=0.97 * one, eps_p=one)
    seen.note(wild, calm, steel_alone)
    seen.note(calm, calm, steel_alone)  # what was stays
    (line,) = seen.warnings(2, {"particle": nickel, "target": steel}, True)
    assert line.startswith("impact 2: beyond the fitted range: particle (Ni, ")
    assert "strain rate 3.0e+07 1/s (99th percentile; fitted up to 1e+04)" in line
    assert "0.95 of the melting point (valid up to 0.9)" in line
    assert "target" not in line
    splat = Extremes()  # of aluminium on steel: it counted in its own impact
    hot = holding(**at_rest | {"T": np.where(np.arange(200) > 190, 0.97 * material("Al").T_m, 300.0)})
    splat.note(calm, hot, steel_alone)
    assert splat.warnings(1, {"particle": nickel, "target": steel}, True) == []
    splat.note(calm, hot, both)  # a layer
    assert "0.97 of the melting point" in splat.warnings(1, {"particle": nickel, "target": steel}, True)[0]
    # a linear equation of state is 5 % short at that compression
    linear = greatest_compression(nickel, False)
    assert pressure(nickel, linear) / (nickel.K * linear) == pytest.approx(1.05, abs=0.004)
    assert len(seen.warnings(2, {"particle": nickel, "target": steel}, False)) == 2
    # behind a shock of 2 km/s: rho U u
    shock = nickel.rho * (nickel.c0 + nickel.s * 2000.0) * 2000.0
    assert pressure(nickel, greatest_compression(nickel, True)) == pytest.approx(shock)


def test_the_law_without_effects_is_elastic_perfectly_plastic_but_for_hardening() -> None:
    record = law.law_record(material("Ni"), dict.fromkeys(NAMES, False))[0]
    assert law.yield_stress(record, 0.5, 1e7, 900.0) == pytest.approx(
        material("Ni").strength["A"] + material("Ni").strength["B"] * 0.5 ** material("Ni").strength["n"]
    )
    assert law.harden(record, 0.1, 1e-9, 1.0, 1e8, 1e8, 0.0, 0.0, 300.0)[2] == 300.0
    assert law.law_record(elastic())[0]["expansion"] == 1.0


OF_THE_LAW = (
    "thermal_softening", "rate_hardening", "plastic_heating", "temperature_dependent_cp", "mie_gruneisen", "thermal_expansion",
)  # fmt: skip
CHOICES = {"nothing": {}, **{name: {name: False} for name in OF_THE_LAW}, "all": dict.fromkeys(OF_THE_LAW, False)}
# each choice is a type of its own, for which both kernels are compiled
LEFT_OUT = pytest.mark.parametrize(
    "choice",
    [
        pytest.param(choice, id=name, marks=() if name in ("nothing", "all") else pytest.mark.slow)
        for name, choice in CHOICES.items()
    ],
)


def flowing(laws: np.ndarray, general: bool = False, replaced: int | None = None) -> dict[str, np.ndarray]:
    """A block that twists and flows, after ten steps with kernels of its own laws or with the general ones.

    replaced: stands in its own laws for each number of an effect that is off.
    """
    m = meshes.prepare(*mesher.box((1.0, 1.0, 1.0), 0.25))
    t = Target(m, laws, 400.0, fixed=(), track_wave=False)
    if general:
        t._of_pressure = t._of_flow = t.metals
    if replaced is not None:
        t._of_pressure, t._of_flow = (own._replace(laws=own.laws.copy()) for own in (t._of_pressure, t._of_flow))
        for record in (t._of_pressure.laws, t._of_flow.laws):
            for name in (name for name in record.dtype.names if record.dtype[name] == np.int64):
                record[name] = replaced
    x = m.points - 0.5
    t.nodes.v[:] = 500.0 * np.stack([-x[:, 1] * x[:, 2], x[:, 0] * x[:, 2], -0.3 * x[:, 2]], axis=1)
    dt = 0.5 * t.stable_dt()
    for _ in range(10):
        t.advance(dt)
        t.finish()
    assert np.mean(t.elements.eps_p > 0.0) > 0.5
    return vars(t.nodes) | vars(t.elements) | vars(t.balance)


def squeezed(laws: np.ndarray, law_of_kernel: np.ndarray) -> dict[str, np.ndarray]:
    """Points under pressure, half of which flow, after two steps of the law."""
    rng, n = np.random.default_rng(3), 50
    names = "eps", "e", "de", "sigma_y", "eps_p", "rate", "T", "J", "p", "energy", "set_e", "work"
    a = {name: np.zeros(n) for name in names}
    a["J"], a["sigma_y"], a["T"] = rng.uniform(0.96, 1.01, n), rng.uniform(2e8, 4e8, n), rng.uniform(350.0, 800.0, n)
    a["eps_p"], a["rate"] = rng.uniform(0.1, 1.0, n), np.full(n, 1e7)
    sums = np.zeros(2)
    for _ in range(2):
        stress = np.zeros((n, 6))
        stress[:, [0, 3, 5]] = (laws["K"][0] * rng.uniform(-0.05, 0.01, n))[:, None]
        a["eps"] = a["sigma_y"] / 1e9 + np.where(np.arange(n) % 2, 3e-4, 0.0)
        state = State(
            law_of=np.zeros(n, np.int32),
            stress=stress,
            eps_gradient=np.zeros((n, 3)),
            **{name: a[name] for name in a.keys() & set(State._fields)},
        )
        of_machdyn = np.ones(n), a["eps"], a["e"], a["de"], a["set_e"]
        points_law.apply_law(law_of_kernel, 1e-10, 1e9, np.ones(n), *of_machdyn, state, sums)
    return a | {"sums": sums}


@LEFT_OUT
def test_kernels_without_an_effect_agree_with_the_general_ones(choice: dict[str, bool]) -> None:
    """What is off is a zero to the general kernels, and not there in those that are made for it."""
    steel, nickel = (law.law_record(material(name), choice, rate_filter=1e-9) for name in ("SS304", "Ni"))
    special = law.specialised(nickel)
    assert np.shares_memory(special, nickel)
    assert special.tolist() == nickel.tolist()
    for own, general in (
        (flowing(steel), flowing(steel, general=True)),
        (squeezed(nickel, special), squeezed(nickel, nickel)),
    ):
        for name, values in own.items():
            np.testing.assert_allclose(
                values, general[name], rtol=1e-12, atol=1e-12 * np.abs(general[name]).max(), err_msg=name
            )


def test_a_kernel_leaves_out_only_what_is_off_in_all_materials() -> None:
    heats = {"dissipation_heat": True}
    soft, hard = (
        law.law_record(material("Ni"), heats | {name: False}) for name in ("rate_hardening", "thermal_softening")
    )
    record = law.specialised(np.concatenate([soft, hard])).dtype
    second_regime_and_other_laws = {
        "C_high",
        "gradient_length",
        "zerilli_armstrong",
        "steinberg_guinan",
        "preston_tonks_wallace",
    }
    assert {name for name in record.names or () if record[name] != np.float64} == second_regime_and_other_laws
    assert law.specialised(soft).dtype["C"] == np.int64
    assert law.specialised(soft, law.PRESSURE).dtype == law.LAW
    both = np.concatenate([law.law_record(material("Cu", which), heats) for which in ("Johnson_1983", "Preston_2003")])
    seen = law.specialised(both).dtype
    assert {name for name in seen.names or () if seen[name] != np.float64} == {
        "C_high",
        "cp_slope",
        "gradient_length",
        "zerilli_armstrong",
        "steinberg_guinan",
    }


def test_a_kernel_without_an_effect_does_not_read_its_number() -> None:
    """Any other number in its place changes nothing, to the last bit."""
    steel, nickel = (law.law_record(material(name), CHOICES["all"], rate_filter=1e-9) for name in ("SS304", "Ni"))
    other = law.specialised(nickel).copy()
    for name in (name for name in other.dtype.names or () if other.dtype[name] == np.int64):
        other[name] = 7
    for own, changed in (
        (squeezed(nickel, law.specialised(nickel)), squeezed(nickel, other)),
        (flowing(steel), flowing(steel, replaced=7)),
    ):
        for name, values in own.items():
            np.testing.assert_array_equal(values, changed[name], err_msg=name)


COARSE = {"resolution__spacing": "3.4 um"}  # 200 points
WIDE = {"substrate__diameter": "800 um", "substrate__height": "400 um"}


def test_what_is_off_does_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without effects nothing of them is built, and none of their code is called in a step; with all of them it is."""
    from coupler.fe import explicit
    from coupler.impact import heat
    from coupler.impact.domains import build_domains
    from coupler.impact.exchange import Impact
    from coupler.impact.loop import advance_chunk
    from coupler.particle.heat import PointConduction

    called: list[str] = []

    def spy(owner: object, name: str) -> None:
        original = getattr(owner, name)

        def wrapper(*args: object) -> object:
            called.append(name)
            return original(*args)

        monkeypatch.setattr(owner, name, wrapper)

    for owner, name in ((PointConduction, "share"), (heat, "crossing"), (explicit.Conduction, "advance")):
        spy(owner, name)
    spy(explicit.Target, "warm")
    for effects_of in ("none", "all"):
        called.clear()
        domains = build_domains(plan(scene_with(effects=effects_of, particle__velocity="1500 m/s", **COARSE, **WIDE)))
        impact = Impact(domains)
        for _ in range(3):
            advance_chunk(impact)
        assert set(called) == (set() if effects_of == "none" else {"share", "crossing", "advance", "warm"})
        on = effects_of == "all"
        assert (domains.target.conduction is not None) == (domains.contact.constants.friction > 0) == on
        assert bool(len(domains.target.dashpot_nodes)) == on
        assert (domains.contact.sums.friction_heat > 0.0) == on
        assert domains.target.active_elements < 0.95 * len(
            domains.target.mesh.conn
        )  # those that the waves have reached
        impact.particle.close()


def test_a_summary_keeps_effects_and_names_limits_that_were_left(tmp_path: Path) -> None:
    scene = scene_with(effects=["auto", "-conduction"], particle__velocity="1200 m/s", end__time="6 ns", **COARSE)
    summary = run(scene, tmp_path / "run", threads=1).values
    assert summary["effects"] == plan(scene).effects.active
    (line,) = [text for text in summary["warnings"] if "fitted" in text]
    assert line.startswith("impact 1: beyond the fitted range: particle (Ni, Johnson_1983) strain rate ")
    assert "; target (SS304, paper_2023) strain rate " in line
