import re

import pytest

from coupler.errors import ColdsprayError, SceneError
from coupler.physics import materials

PAPER = {  # doi 10.1016/j.jestch.2023.101579, table 1: rho, G, T_m, c0, Gamma0, s, A, B, C, n, m
    "Ni": (8906, 76e9, 1726, 4542, 1.83, 1.5, 163e6, 648e6, 0.006, 0.33, 1.44),
    "Ti": (4510, 30e9, 1923, 5020, 1.23, 1.53, 807e6, 482e6, 0.019, 0.319, 0.66),
    "SS304": (7920, 86e9, 1800, 4570, 1.93, 1.49, 260e6, 1350e6, 0.02, 0.62, 1.0),
}
HEAT = {  # cp and k at 300 and 1073 K
    "Ni": ((456, 490), (91, 71)),
    "Ti": ((528, 615), (11.4, 16)),
    "SS304": ((450, 640), (16.2, 26)),
}


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_table(name):
    m = materials.material(name)
    assert (m.rho, m.G, m.T_m, m.c0, m.Gamma0, m.s, *(m.strength[key] for key in "ABCnm")) == PAPER[name]
    (cp0, cp1), (k0, k1) = HEAT[name]
    assert m.cp == ((300, cp0), (1073, cp1))
    assert m.k == ((300, k0), (1073, k1))
    assert (m.T_ref, m.taylor_quinney, m.strength["eps_dot_0"]) == (300, 0.9, 1.0)


def test_the_library_has_what_engineers_start_from():
    """Twenty metals and more, several strength sets of nickel, copper, aluminium, titanium alloy and steel, each with its source."""
    assert set(materials.names()) >= {
        "Ni",
        "Ti",
        "SS304",
        "OFHC_Cu",
        "Al",
        "42CrMo4",
        "CP_Ti",
        "Ti6Al4V",
        "SS316L",
        "IN718",
        "Ta",
        "Brass",
    }
    assert len(materials.names()) >= 20
    entries = [materials.entry(name) for name in materials.names()]
    assert all(
        re.search("read|second-hand", text)
        for entry in entries
        for m in entry.materials
        for text in (m.source, m.strength.source)
    )
    assert all(len(materials.entry(name).sets) > 1 for name in ("Ni", "Cu", "Al", "Ti6Al4V", "SS304"))


@pytest.mark.parametrize("name", materials.names())
def test_elastic_constants_are_those_of_a_metal(name):
    """Poisson's ratio of G and rho c0^2: 0.25 (Zn) to 0.40 (Nb), of ceramics 0.14 to 0.24, by handbooks; a c0 or a G of another
    material falls outside. A ceramic stays elastic up to its Hugoniot elastic limit, above the strength of any metal here."""
    m = materials.material(name)
    low, high = (0.14, 0.24) if m.is_ceramic else (0.24, 0.40)
    assert low < m.nu < high
    assert (m.flow_stress(0.0, 1e7, 300.0) > 2.5e9) == m.is_ceramic


def test_a_ceramic_has_a_tensile_limit_and_a_metal_has_none():
    tables = {
        "Hard": {"base": "SiC", "tensile_limit": "2 GPa"}, "Bare": {"base": "Ni", "kind": "ceramic"},
        "Soft": {"base": "Ni", "tensile_limit": "2 GPa"}, "Glass": {"base": "Ni", "kind": "glass"},
    }  # fmt: skip
    catalogue, problems = materials.from_scene(tables)
    assert catalogue["Hard"].tensile_limit == 2e9
    assert [problem.partition(":")[0] for problem in problems] == [
        "materials.Bare",
        "materials.Soft",
        "materials.Glass",
    ]
    assert "tensile_limit: missing" in problems[0]
    assert "tensile_limit has no effect on a metal" in problems[1]
    assert 'kind must be "metal" or "ceramic"' in problems[2]


def test_tin_has_the_moduli_of_handbooks():
    """E 50 GPa, nu 0.36, G 18 GPa (WebElements); the c0 that Uintah prints, 5240 m/s, would give nu 0.46."""
    tin = materials.material("Sn")
    assert (tin.E, tin.nu, tin.G) == pytest.approx((50e9, 0.36, 18e9), rel=0.07)


def test_the_bilinear_set_of_6061_has_a_second_regime():
    """At 1e7 1/s the rate term is 1 + 0.002 ln 597.2 + 0.0029 ln(1e7 / 597.2), and continuous at 597.2 1/s."""
    metal = materials.material("Al6061", "Lin_2019")
    static = 270e6 + 154.3e6 * 0.2**0.239
    assert metal.flow_stress(0.2, 1e7, 298.0) == pytest.approx(
        static * (1.0 + 0.002 * 6.3922 + 0.0029 * 9.7259), rel=1e-4
    )
    assert metal.flow_stress(0.2, 597.3, 298.0) == pytest.approx(metal.flow_stress(0.2, 597.1, 298.0), rel=1e-5)


def test_other_names_are_understood():
    assert materials.material("Cu") is materials.material("OFHC_Cu")
    assert materials.material("AISI4140") is materials.material("42CrMo4")
    assert materials.material("Nickel") is materials.material("nickel") is materials.material("Ni")
    assert materials.from_scene({})[0]["Cu"] is materials.material("OFHC_Cu")
    changed = materials.from_scene({"OFHC_Cu": {"T_m": "1300 K"}})[0]
    assert [changed[name].T_m for name in ("OFHC_Cu", "Cu", "copper")] == [1300.0] * 3
    own = materials.from_scene({"OFHC_Cu": {"T_m": "1300 K"}, "Cu": {"T_m": "1200 K"}})[0]
    assert [own[name].T_m for name in ("OFHC_Cu", "Cu", "copper")] == [1300.0, 1200.0, 1300.0]
    assert materials.from_scene({"WC-Co": {"kind": "metal"}})[1] == []
    with pytest.raises(ColdsprayError, match='did you mean "Copper"'):
        materials.material("Coper")


def test_a_strength_set_is_chosen_by_its_name_or_its_law():
    preston = materials.material("Cu", "Preston_2003")
    assert preston == materials.material("OFHC_Cu", "preston_tonks_wallace")
    assert preston.flow_stress(0.3, 1e7, 300.0) > 1.5 * materials.material("Cu").flow_stress(0.3, 1e7, 300.0)
    with pytest.raises(
        ColdsprayError,
        match=r"Ni has no strength set or law of this name; it has Johnson_1983 \(johnson_cook\), Steinberg_1996",
    ):
        materials.material("Ni", "Preston_2003")
    table = {
        "Cu": {"strength": "zerilli_armstrong", "C_0": "80 MPa"},
        "Mine": {"base": "Ni", "strength": "Steinberg_1996"},
    }
    catalogue, problems = materials.from_scene(table, "Preston_2003", {"Cu", "Mine", "OFHC_Cu"})
    assert problems == []
    assert (catalogue["Cu"].strength["C_0"], catalogue["Cu"].strength["C_2"]) == (80e6, 890e6)
    assert (catalogue["Mine"].name, catalogue["Mine"].strength.set) == ("Mine", "Steinberg_1996")
    assert catalogue["OFHC_Cu"].strength.set == "Preston_2003"
    assert (
        "strength = 'Preston_2003': Ni has no strength set or law"
        in materials.from_scene({}, "Preston_2003", {"Ni"})[1][0]
    )
    assert catalogue["Cu"].strength.set == ""  # numbers of its own: no set of the library
    other = {
        "Own": {
            "base": "Ni",
            "law": "zerilli_armstrong",
            "C_0": "50 MPa",
            "C_3": "0.002 1/K",
            "C_4": "1e-4 1/K",
            "C_2": "500 MPa",
        }
    }
    assert materials.from_scene(other, "Steinberg_1996", {"Own"})[0]["Own"].strength.law == "zerilli_armstrong"


@pytest.mark.parametrize(
    ("symbol", "name"), [("Al", "aluminium"), ("Ti", "titanium"), ("Cu", "copper"), ("Mg", "magnesium")]
)
def test_symbol_and_name_of_an_element_are_one_metal(symbol: str, name: str) -> None:
    assert materials.material(symbol) is materials.material(name) is materials.material(name.capitalize())


def test_a_metal_by_the_constants_of_handbooks() -> None:
    """E = 2 G (1 + nu) = 3 K (1 - 2 nu), and K = rho c0^2; what is not said is that of the base."""
    own = {"E": "207 GPa", "nu": 0.31, "density": "8900 kg/m^3"}
    catalogue, problems = materials.from_scene({"Own": {"base": "Ni"} | own, "Soft": {"base": "Ni", "E": "100 GPa"}})
    assert problems == []
    metal, nickel = catalogue["Own"], catalogue["Ni"]
    assert (metal.E, metal.nu, metal.rho) == pytest.approx((207e9, 0.31, 8900.0))
    assert metal.rho * metal.c0**2 == pytest.approx(207e9 / (3.0 * (1.0 - 0.62)))
    assert (catalogue["Soft"].E, catalogue["Soft"].nu) == pytest.approx((100e9, nickel.nu))
    for wrong, says in (
        ({"G": "80 GPa"}, "G follows from E and nu: give only one of them"),
        ({"rho": "8900 kg/m^3"}, "rho follows from density: give only one of them"),
        ({"nu": 0.5}, "nu is outside 0 to 0.495"),
    ):
        assert f"materials.Own: {says}" in materials.from_scene({"Own": {"base": "Ni"} | own | wrong})[1]
    alone = materials.from_scene({"Own": {"E": "207 GPa"}})[1]
    assert "materials.Own: E needs nu, too" in alone


def test_pure_aluminium_is_annealed():
    """Its first set has 49 + 157 MPa at a strain of 1, 1 1/s and its reference temperature."""
    m = materials.material("Al1100")
    assert m.strength.set == "Pierazzo_2008"
    assert m.flow_stress(1.0, 1.0, 293.0) == pytest.approx(206e6)


def test_a_set_may_have_a_melting_point_of_its_own():
    assert materials.material("SS304", "Lee_2006").T_m == 1673.0
    assert materials.material("SS304").T_m == 1800.0


def test_constant_heat_is_one_value():
    catalogue, problems = materials.from_scene({"Flat": {"base": "Ni", "cp": "440 J/(kg K)", "k": "90 W/(m K)"}})
    assert problems == []
    assert [catalogue["Flat"].cp_at(T) for T in (200.0, 500.0, 1500.0)] == [440.0] * 3
    varies = {"Hot": {"base": "Cu", "thermal_expansion": [["300 K", "16.5e-6 1/K"], ["900 K", "20e-6 1/K"]]}}
    assert materials.from_scene(varies)[0]["Hot"].thermal_expansion_at(600.0) == pytest.approx(18.25e-6)


@pytest.mark.parametrize("hardness", [150.0, 163.0, 220.0])
def test_hardness_is_an_initial_plastic_strain(hardness):
    """Tabor (1951): after 8 % of further strain the flow stress is a third of the hardness; a yield strength is the flow stress."""
    nickel = materials.material("Ni")
    eps = nickel.initial_strain(hardness * 9.80665e6, None)
    assert nickel.flow_stress(eps + 0.08, 0.0, 293.0) == pytest.approx(hardness * 9.80665e6 / 3, rel=1e-9)
    assert nickel.flow_stress(nickel.initial_strain(None, 400e6), 0.0, 293.0) == pytest.approx(400e6, rel=1e-9)
    assert nickel.initial_strain(None, None) == 0.0
    with pytest.raises(ValueError, match=r"is outside 136.* HV, the range of"):
        nickel.initial_strain(100 * 9.80665e6, None)


def test_elastic_constants():
    steel = materials.material("42CrMo4")
    assert pytest.approx(206e9) == steel.E
    assert steel.nu == pytest.approx(0.3)
    assert pytest.approx(steel.rho * steel.c0**2) == steel.K
    assert steel.T_ref == 293.15
    assert materials.material("Ni").wave_speed == pytest.approx(5658, abs=1)


def test_cp_is_linear_between_its_points_and_constant_outside():
    nickel = materials.material("Ni")
    assert nickel.cp_at(686.5) == pytest.approx(473)
    assert (nickel.cp_at(100), nickel.cp_at(2000)) == (456, 490)
    assert nickel.k_at(686.5) == pytest.approx(81)


def test_unknown_name_offers_the_nearest():
    with pytest.raises(ColdsprayError, match='did you mean "Ni"'):
        materials.material("ni")


def test_a_scene_may_change_one_number():
    catalogue, problems = materials.from_scene({"MyNi": {"base": "Ni", "A": "180 MPa"}, "Ti": {"A": "0.4 GPa"}})
    assert problems == []
    assert (catalogue["MyNi"].strength["A"], catalogue["MyNi"].strength["B"]) == (180e6, 648e6)
    assert "changed in the scene: A" in catalogue["MyNi"].source
    assert (catalogue["Ti"].strength["A"], materials.material("Ti").strength["A"]) == (400e6, 807e6)


def test_all_problems_of_a_material_at_once():
    table = {"A": 163, "B": "648 K", "rho": "-1 kg/m^3", "cp": ["456 J/(kg K)"], "q": 1, "note": "`rm`"}
    with pytest.raises(SceneError) as caught:
        materials.from_table("X", table, materials.material("Ni"))
    text = "\n".join(caught.value.problems)
    assert len(caught.value.problems) == 6
    for part in (
        "A needs a pressure",
        "B is a temperature",
        "rho is outside",
        "cp must be one value or two pairs",
        "'q'",
        "note",
    ):
        assert part in text


@pytest.mark.parametrize(
    ("name", "table", "says"),
    [
        ("X", {}, "missing: rho, G"),
        ("X", {"base": "Nn"}, "base"),
        ("X; shell", {"base": "Ni"}, "letters, digits"),
        ("X", {"base": "Ni", "T_m": "250 K"}, "above T_ref"),
        ("X", {"base": "Ni", "G": "900 GPa"}, "Poisson"),
        ("X", {"base": "Ni", "s": float("nan")}, "outside"),
        ("X", {"base": "Ni", "A": "-5 MPa"}, "A is outside 0.1 MPa to 20000 MPa"),
        ("X", {"base": "Ni", "cp": "0 J/(kg K)"}, "cp is outside 10 J/(kg K) to 10000"),
        ("X", {"base": "Ni", "cp": [["300 K", "450 J/(kg K)"], ["1000 K", "-5 J/(kg K)"]]}, "cp is outside"),
        (
            "X",
            {"base": "Cu", "strength": "zerilli_armstrong", "C_0": "0 MPa"},
            "give no positive yield stress at 300 K",
        ),
        (
            "X",
            {"base": "Ni", "C_high": 0.02, "eps_dot_0": "1e6 1/s"},
            "eps_dot_high (1000 1/s) must not be below eps_dot_0 (1e+06 1/s)",
        ),
        ("X", {"base": "Ni", "law": "johnson-cook"}, 'did you mean "johnson_cook"'),
        ("X", {"base": "Ni", "law": "preston_tonks_wallace"}, "missing: theta, p, s_0"),
        ("X", {"base": "Ni", "theta": 0.02}, "'theta': unknown key"),
        ("X", {"base": "Ni", "fitted": {"rate": ["10 1/s", "1 1/s"]}}, "fitted rate must have the smaller value first"),
        ("X", {"strength": "Johnson_1983", "rho": "8000 kg/m^3"}, "needs a material of the library to start from"),
    ],
)
def test_faulty_materials(name, table, says):
    _, problems = materials.from_scene({name: table})
    assert len(problems) == 1
    assert says in problems[0]
