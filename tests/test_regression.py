"""Coarse runs held to what they gave before: tests/goldens/*.toml.

A golden says for each impact what each measure was and by how much it may differ. After a change that is meant to move them:
`pytest tests/test_regression.py --update-golden`, and look at the difference before keeping it. The tolerances are those of the
file; a measure that is new to it gets the one below.

Tolerances of sequences: the larger of the one below and three times the largest deviation within an ensemble, which the golden
names. Its runs have the first velocity times 1 + k 1e-13, or numpy on another vector unit (NPY_DISABLE_CPU_FEATURES="X86_V4
AVX512_ICL" is AVX2, with X86_V3 also SSE): rounding, which can make another mesh of a splat, and more so of one on a splat.
"""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from runs import SharedRuns
from scenes import NI, scene

from coupler import Result

GOLDENS = Path(__file__).parent / "goldens"
# Measure -> what it may differ by, as a share of its value and absolutely; the larger counts. Far above what another machine's
# rounding makes of these runs, far below what the resolution does.
TOLERANCES: dict[str, tuple[float, float]] = {
    "flattening_ratio": (0.0, 0.005),
    "flattening_ratio_total": (0.0, 0.005),
    "crater_depth_m": (0.015, 0.0),
    "splat_diameter_m": (0.01, 0.0),
    "eps_p_mean": (0.02, 0.0),
    "eps_p_p99": (0.08, 0.0),
    "T_mean_K": (0.005, 0.0),
    "T_p99_K": (0.03, 0.0),
    "von_mises_max_Pa": (0.05, 0.0),
    "target_eps_p_max": (0.10, 0.0),
    "plastic_radius_m": (0.03, 0.0),
    "plastic_depth_m": (0.05, 0.0),
    "velocity_z_m_s": (0.10, 3.0),
    "energy_drift": (0.0, 0.001),
    "numerical_dissipation": (0.0, 0.004),
    "time_s": (0.05, 0.0),
    "steps": (0.10, 0.0),
    "elements": (0.05, 0.0),
}
OF_THE_END = ("flattening_ratio", "flattening_ratio_total", "splat_diameter_m")  # as the last impact leaves the splat

ALL = 'effects = "all"\n'  # what auto leaves out is no matter of these
SCENES = {
    "single_ni": NI,
    "single_ti": scene(("Ti", 30, 500), spacing=3.6, element_size=5.4),
    "double_ni_ti": ALL + scene(("Ni", 30, 500), ("Ti", 25, 500)),
    # the smallest of three needs 200 points
    "triple_ni": ALL + scene(("Ni", 25, 500), ("Ni", 22, 546), ("Ni", 18, 610), spacing=2.4),
}


def measured(result: Result) -> list[dict[str, float]]:
    """The measures of each impact of a run that a golden holds."""
    found = []
    for i, impact in enumerate(result.impacts):
        own = result.impact(i)
        values = {name: float(own[name]) for name in TOLERANCES}
        standing = impact.get("at_end", impact["end"])  # nothing follows the last one
        if standing is not None:
            values |= {f"at_end.{name}": float(standing[name]) for name in OF_THE_END}
        found.append(values)
    return found


def allowed(name: str, value: float) -> float:
    """What a measure may differ by when its golden does not say."""
    share, least = TOLERANCES[name.removeprefix("at_end.")]
    return max(share * abs(value), least)


def differences(golden: dict[str, Any], values: list[dict[str, float]]) -> list[str]:
    """Lines about each measure that is not what the golden says, or that only one of both has."""
    if len(golden["impact"]) != len(values):
        return [f"{len(values)} impacts, golden {len(golden['impact'])}"]
    lines = []
    for number, (held, got) in enumerate(zip(golden["impact"], values, strict=True), 1):
        held = {k: v for k, v in held.items() if k != "at_end"} | {
            f"at_end.{k}": v for k, v in held.get("at_end", {}).items()
        }
        for name in sorted(held.keys() ^ got.keys()):
            lines.append(f"impact {number} {name}: {'gone' if name in held else 'not in the golden'}")
        for name in [name for name in got if name in held]:
            value, within = held[name]["value"], held[name]["within"]
            if not abs(got[name] - value) <= within:
                change = f"differs by {got[name] - value:+.3g}, allowed {within:.3g}"
                lines.append(f"impact {number} {name}: {got[name]:.6g}, golden {value:.6g}, {change}")
    return lines


def as_toml(values: list[dict[str, float]], old: dict[str, Any]) -> str:
    """A golden as text: the values, with the tolerances of the old one where it has them."""
    lines = [
        "# pytest tests/test_regression.py --update-golden writes the values anew and keeps what they may differ by (within)."
    ]
    if "ensemble" in old:
        lines.append(f'ensemble = "{old["ensemble"]}"')
    for number, got in enumerate(values):
        before = old.get("impact", [])[number : number + 1] or [{}]
        known = before[0] | {f"at_end.{k}": v for k, v in before[0].get("at_end", {}).items()}
        lines += ["", "[[impact]]"]
        for name, value in got.items():
            within = known[name]["within"] if name in known else allowed(name, value)
            lines.append(f"{name} = {{ value = {value:.6g}, within = {float(f'{within:.2g}')} }}")
    return "\n".join(lines) + "\n"


# Scene, engine, whether it is slow. The two engines of MACHDYN's scheme are equal to rounding: they share goldens.
RUNS = [(name, "enriched", name == "triple_ni") for name in SCENES]
RUNS += [(name, "compiled", not name.startswith("single")) for name in SCENES]
RUNS += [(name, "machdyn", True) for name in SCENES]


@pytest.mark.parametrize(
    ("name", "engine"),
    [pytest.param(*run, marks=[pytest.mark.slow] if slow else []) for *run, slow in RUNS],
)
def test_a_coarse_run_gives_what_it_gave(name: str, engine: str, shared_run: SharedRuns, update_golden: bool) -> None:
    scheme = "" if engine == "enriched" else "_machdyn"
    path = GOLDENS / f"{name}{scheme}.toml"
    text = SCENES[name]
    if scheme:  # LAMMPS's own does not tell which points dissipate
        text = f'effects = ["all", "-dissipation_heat"]\n{text.removeprefix(ALL)}'
        text = text.replace("[resolution]\n", f'[resolution]\nengine = "{engine}"\n')
    values = measured(shared_run(text))
    old = tomllib.loads(path.read_text()) if path.exists() else {}
    if update_golden:
        path.parent.mkdir(exist_ok=True)
        path.write_text(as_toml(values, old))
    else:
        assert old, f"{path} is missing: pytest tests/test_regression.py --update-golden writes it"
        lines = differences(old, values)
        assert not lines, "\n".join([f"{name} is not what it was:", *lines])


def test_a_difference_is_said_and_an_update_keeps_the_tolerances() -> None:
    values = [{"flattening_ratio": 0.56, "crater_depth_m": 5.2e-6, "at_end.flattening_ratio": 0.6}]
    golden = tomllib.loads(as_toml(values, {}))
    assert golden["impact"][0]["at_end"]["flattening_ratio"] == {"value": 0.6, "within": 0.005}
    assert not differences(golden, values)
    moved = [{**values[0], "flattening_ratio": 0.58, "at_end.flattening_ratio": 0.603}]
    assert differences(golden, moved) == [
        "impact 1 flattening_ratio: 0.58, golden 0.56, differs by +0.02, allowed 0.005"
    ]
    assert len(differences(golden, [{**values[0], "crater_depth_m": float("nan")}])) == 1
    assert differences(golden, values * 2) == ["2 impacts, golden 1"]
    assert differences(golden, [{"flattening_ratio": 0.56, "steps": 3.0}]) == [
        "impact 1 at_end.flattening_ratio: gone",
        "impact 1 crater_depth_m: gone",
        "impact 1 steps: not in the golden",
    ]
    golden["impact"][0]["flattening_ratio"]["within"] = 0.03
    golden["ensemble"] = "k = -1, 1"
    again = tomllib.loads(as_toml(moved, golden))
    assert again["ensemble"] == "k = -1, 1"
    assert again["impact"][0]["flattening_ratio"] == {"value": 0.58, "within": 0.03}
