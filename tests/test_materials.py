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


def test_every_material_has_its_source():
    assert set(materials.names()) >= {"Ni", "Ti", "SS304", "OFHC_Cu", "Al", "42CrMo4"}
    assert all(materials.material(name).source for name in materials.names())


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
    ],
)
def test_faulty_materials(name, table, says):
    _, problems = materials.from_scene({name: table})
    assert len(problems) == 1
    assert says in problems[0]
