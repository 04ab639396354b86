"""Hard scenes, one after another: python workflows/stability.py [--only TEXT] [--docs]

Coarse (300 to 600 points), so that all of them take minutes. Rows in the table are not computed again, so that the battery goes on
where it was stopped. What each scene is judged by is in CHECKS; a scene that fails is a row with its cause.
"""

import argparse
import tempfile
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pages import PAGES, markdown, marked, study_table, versions, write_parts

from coupler import Scene, run
from coupler.deposition.joining import cloud_of
from coupler.deposition.run import resume
from coupler.errors import ColdsprayError
from coupler.fe.assemble import BodyState, domain_of
from coupler.fe.explicit import Target
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_window
from coupler.plan.planning import plan
from coupler.progress import Progress
from coupler.splat.convert import convert
from coupler.studies.table import Row

POINTS = 400
DRIFT, MOMENTUM = 0.01, 1e-6
DISSIPATION = (-0.01, 0.20)  # of the initial kinetic energy, both schemes together, so coarse as they are here
PENETRATION = 0.5  # spacings
PATIENCE = 180.0  # s of processor time for one scene
COLUMNS = (
    "scene", "verdict", "points", "steps", "end ns", "flattening", "drift", "momentum", "dissipated", "penetration", "stretch",
    "eps_p max", "T max over T_m", "rescues", "cpu s", "why",
)  # fmt: skip

CHECKS = f"""Each scene must:

- finish, without a NaN, a lost or switched-off point, or an inverted element (the solver stops at each of these);
- close its energy ledger within {DRIFT:.0%} of the initial kinetic energy, momentum within {MOMENTUM:.0e} (in a sequence: each impact);
- press the surfaces into each other by less than {PENETRATION:g} of the spacing of the points;
- never let a plastic strain fall, looked at every ten steps at all points and elements;
- lose {DISSIPATION[0]:.0%} to {DISSIPATION[1]:.0%} of the initial kinetic energy to its schemes (viscosity, hourglass control, kernel);
- stay at or below melting, or say in its warnings that it did not.
"""


class Slow(Exception):
    """A scene has used up its time."""


@dataclass
class Watching:
    """A probe of an `Impact`, called after each window of steps. lowest: the smallest stretch; fallen: the largest fall of a
    plastic strain."""

    lowest: float = 1.0
    fallen: float = 0.0
    started: float = field(default_factory=clock.process_time)
    _before: tuple[Impact, float, list[np.ndarray]] | None = None

    def __call__(self, impact: Impact) -> None:
        strains = [np.array(impact.particle.eps_p), np.array(impact.target.eps_p)]
        if self._before is not None and self._before[0] is impact and self._before[1] < impact.time:
            self.fallen = max(
                self.fallen, *(float(np.max(a - b)) for a, b in zip(self._before[2], strains, strict=True))
            )
        self._before = (impact, impact.time, strains)
        self.lowest = min(self.lowest, impact.particle.stretch_min)
        if clock.process_time() - self.started > PATIENCE:
            at = f"{impact.time * 1e9:.1f} ns, dt {impact.particle.dt * 1e12:.2f} ps"
            raise Slow(f"not done after {PATIENCE:.0f} s: at {at}")


def particle(
    material: str = "Ni", diameter: float = 25.0, velocity: float = 500.0, *, T: float = 300.0, angle: float = 0.0,
    offset: tuple[float, float] = (0.0, 0.0), shape: str = "sphere", tilt: float = 0.0,
) -> dict[str, object]:  # fmt: skip
    """A table [particle]; um, m/s, K, degrees."""
    return {
        "material": {"Cu": "OFHC_Cu"}.get(material, material), "diameter": f"{diameter} um", "velocity": f"{velocity} m/s",
        "temperature": f"{T} K",
        "angle": f"{angle} deg", "offset": [f"{offset[0]} um", f"{offset[1]} um"], "shape": shape, "tilt": f"{tilt} deg",
    }  # fmt: skip


def scene(
    *particles: dict[str, object], on: str = "SS304", points: int = POINTS, **more: dict[str, object]
) -> dict[str, object]:
    """A scene with so many points in its largest particle, on a target four diameters wide."""
    largest = max(float(p["diameter"].split()[0]) for p in particles)
    far = max(np.hypot(*(float(x.split()[0]) for x in p["offset"])) for p in particles)
    wide = 2.0 if any(p["shape"] in ("rod", "flake", "oblate", "hollow_sphere") for p in particles) else 1.0
    spacing = (np.pi / 6 * largest**3 / points) ** (1 / 3)
    substrate = {
        "material": on,
        "diameter": f"{4 * largest * wide + 2 * far:.6g} um",
        "height": f"{2.5 * largest:.6g} um",
    }
    return {
        "particle": list(particles), "substrate": substrate | more.pop("substrate", {}),
        "resolution": {"spacing": f"{spacing:.6g} um"} | more.pop("resolution", {}), **more,
    }  # fmt: skip


def battery() -> dict[str, dict[str, object]]:
    """Scenes by name."""
    p, found = particle, {}
    for material in ("Ni", "Ti", "Al", "Cu", "SS304"):
        for on in ("SS304", "Al", "Ti"):
            found[f"{material} on {on}, 500 m/s"] = scene(p(material), on=on)
    for diameter in (5, 10, 40, 60, 100):
        found[f"Ni {diameter} um"] = scene(p(diameter=diameter))
    for velocity in (50, 150, 300, 750, 1000, 1250, 1500):
        found[f"Ni {velocity} m/s"] = scene(p(velocity=velocity))
    for material, on in (("Ti", "SS304"), ("Al", "SS304"), ("Cu", "Al"), ("SS304", "Al"), ("SS304", "Ti")):
        found[f"{material} on {on}, 1000 m/s"] = scene(p(material, velocity=1000), on=on)
    found["Cu on SS304, 1500 m/s"] = scene(p("Cu", velocity=1500))
    for T in (600, 1000):
        found[f"Ni at {T} K"] = scene(p(T=T))
    found["Ti at 1000 K on Al"] = scene(p("Ti", T=1000), on="Al")
    found["Ni at 1000 K on SS304 at 900 K, 800 m/s"] = scene(
        p(T=1000, velocity=800), substrate={"temperature": "900 K"}
    )
    found["Al at 800 K, near melting"] = scene(p("Al", T=800))
    found["Cu at 1250 K on Al at 780 K, near melting"] = scene(
        p("Cu", T=1250), on="Al", substrate={"temperature": "780 K"}
    )
    for angle in (15, 45, 60, 75):
        found[f"Ni at {angle} degrees"] = scene(p(angle=angle))
    found["Cu 800 m/s at 75 degrees"] = scene(p("Cu", velocity=800, angle=75))
    found["Ti at 45 degrees on Al"] = scene(p("Ti", angle=45), on="Al")
    for name, shape, tilt in (
        ("hollow sphere", "hollow_sphere", 0), ("rod on end", "rod", 90), ("rod lying", "rod", 0), ("rod at 45 degrees", "rod", 45),
        ("flake on edge", "flake", 90), ("flake flat", "flake", 0), ("oblate on edge", "oblate", 90),
        ("angular on a corner", "angular", 35),
    ):  # fmt: skip
        points = {"flake": 1200, "hollow_sphere": 600}.get(shape, POINTS)
        found[f"Ni {name}"] = scene(p(shape=shape, tilt=tilt), points=points)
    found["Ni angular on a corner, 900 m/s"] = scene(p(shape="angular", tilt=35, velocity=900))
    found["Ni friction 0"] = scene(p(), contact={"friction": 0.0})
    found["Ni friction 1"] = scene(p(), contact={"friction": 1.0})
    found["Ni friction 1 at 60 degrees, 800 m/s"] = scene(p(velocity=800, angle=60), contact={"friction": 1.0})
    found["Ni friction 0, 1000 m/s"] = scene(p(velocity=1000), contact={"friction": 0.0})
    found["Ni coarsest"] = scene(p(), points=210)
    found["Ni coarsest, 1000 m/s"] = scene(p(velocity=1000), points=210)
    found["Ni elements four times the spacing"] = scene(p(), points=2000, resolution={"element_size": "6.2 um"})
    found["Ni elements smaller than the spacing"] = scene(p(), resolution={"element_size": "2 um"})
    found["Ni elements that grow at once"] = scene(p(), resolution={"growth": 1.0})
    thin = {"height": "50 um", "bottom": "free", "sides": "free"}
    found["Ni on a thin free substrate, 800 m/s"] = scene(p(velocity=800), substrate=thin)
    found["Ni on a thin fixed substrate of Al"] = scene(
        p(), on="Al", substrate=thin | {"bottom": "fixed", "sides": "fixed"}
    )
    found["Ni followed for 1 us"] = scene(p(), end={"time": "1000 ns"}, output={"every": "50 ns"})
    found["Ni on the rim of a Ni splat"] = scene(p(), p(offset=(15, 0)))
    found["Ni between two Ni splats"] = scene(p(offset=(-17, 0)), p(offset=(17, 0)), p())
    found["Ni on a Ti splat that is not bonded"] = scene(p("Ti"), p(), adhesion={"kind": "none"})
    found["Al on a Ni splat, 700 m/s"] = scene(p(), p("Al", velocity=700))
    found["Cu 15 um on a Ni splat of 25 um"] = scene(p(), p("Cu", diameter=15.5), points=900)
    return found


def judged(
    summary: dict[str, object], seen: Watching, melting: dict[str, float]
) -> tuple[dict[str, object], list[str]]:
    """Row of the table and what is wrong. melting: K by material, "substrate" among them."""
    wrong = []
    impacts = summary["impacts"]
    worst = {
        "drift": max((i["energy_drift"] for i in impacts), key=abs),
        "momentum": max(i["momentum_error"] for i in impacts),
        "dissipated": max((i["numerical_dissipation"] for i in impacts), key=lambda e: abs(e - 0.05)),
        "penetration": max(i["penetration_max_m"] / i["spacing_m"] for i in impacts),
    }
    if not abs(worst["drift"]) <= DRIFT:
        wrong.append(f"ledger open by {worst['drift']:+.2%}")
    if not worst["momentum"] <= MOMENTUM:
        wrong.append(f"momentum off by {worst['momentum']:.1e}")
    if not DISSIPATION[0] <= worst["dissipated"] <= DISSIPATION[1]:
        wrong.append(f"schemes dissipate {worst['dissipated']:.1%}")
    if not worst["penetration"] < PENETRATION:
        wrong.append(f"surfaces {worst['penetration']:.2f} spacings deep in each other")
    if seen.fallen > 0.0:
        wrong.append(f"a plastic strain fell by {seen.fallen:.1e}")
    before = [melting["substrate"]]  # of all that the target is made of: which of it is hottest is not in the summary
    hottest = 0.0
    for i in impacts:
        hottest = max(hottest, i["T_max_K"] / melting[i["material"]], i["target_T_max_K"] / max(before))
        before.append(melting[i["material"]])
    if hottest > 1.0 and not any("beyond melting" in text for text in summary["warnings"]):
        wrong.append(f"{hottest:.3f} of the melting point, not flagged")
    rescued = [f"rescued: {made['reason']}" for made in summary["retries"]]
    row = {
        "why": "; ".join([*wrong, *dict.fromkeys(rescued)]),
        "points": impacts[0]["points"], "steps": summary["steps"], "end ns": f"{summary['sim_time_s'] * 1e9:.1f}",
        "flattening": f"{summary['flattening_ratio']:.3f}", "drift": f"{worst['drift']:+.2%}",
        "momentum": f"{worst['momentum']:.0e}", "dissipated": f"{worst['dissipated']:.1%}",
        "penetration": f"{worst['penetration']:.2f}",
        "stretch": f"{seen.lowest:.2f}", "eps_p max": f"{max(max(i['eps_p_max'], i['target_eps_p_max']) for i in impacts):.1f}",
        "T max over T_m": f"{hottest:.2f}", "rescues": len(summary["retries"]),
    }  # fmt: skip
    return row, wrong


def play(name: str, said: dict[str, object], folder: Path) -> tuple[dict[str, object], list[str]]:
    """Compute a scene and judge it. Its errors are in the row, not raised."""
    seen = Watching()
    try:
        checked = Scene.from_dict(said, "hard")
        result = run(checked, folder / "run", force=True, progress=Progress(quiet=True), threads=1, probe=seen)
    except (ColdsprayError, Slow) as error:
        return {"stretch": f"{seen.lowest:.2f}"}, [f"{type(error).__name__}: {error}"]
    return judged(result.summary, seen, melting_of(checked))


def melting_of(checked: Scene) -> dict[str, float]:
    names = {p.material for p in checked.particles}
    points = {name: checked.derived.material(name).T_m for name in names}
    return points | {"substrate": checked.derived.material(checked.substrate.material).T_m}


def restarted(folder: Path) -> tuple[dict[str, object], list[str]]:
    """1000 m/s at 45 degrees, broken off and resumed from a checkpoint in the middle: the same end to 1e-9."""

    class Enough(Exception):
        pass

    def probe(impact: Impact) -> None:
        if impact.time > 9e-9:
            raise Enough

    checked, seen = Scene.from_dict(scene(particle(velocity=1000, angle=45)), "hard"), Watching()
    whole = run(checked, folder / "whole", force=True, progress=Progress(quiet=True), threads=1, probe=seen).summary
    try:
        run(
            checked,
            folder / "run",
            force=True,
            progress=Progress(quiet=True),
            threads=1,
            probe=probe,
            checkpoint_every=0.0,
        )
    except Enough:
        again = resume(folder / "run", progress=Progress(quiet=True), threads=1).summary
    row, wrong = judged(again, seen, melting_of(checked))
    for key in ("flattening_ratio", "steps", "eps_p_mean", "T_max_K", "crater_depth_m", "energy_drift"):
        if not np.isclose(again[key], whole[key], rtol=1e-9, atol=1e-12):
            wrong.append(f"{key} {again[key]} after the restart, {whole[key]} without")
    return row, wrong


TURN = 1e-6  # s: at the rim 105 m/s, rho v^2 a quarter of the yield stress; in 0.1 us the same splat flies apart


def flying(folder: Path) -> tuple[dict[str, object], list[str]]:
    """A splat as finite elements, alone, 500 m/s and one turn: no plastic strain at all, and energy, momentum and shape as before.

    Its own turning strains it by about rho v_rim^2 / E; that stays elastic as long as rho v_rim^2 is below the yield stress.
    """
    what = plan(Scene.from_dict(scene(particle()), "hard"))
    domains = build_domains(what)
    impact = Impact(domains)
    while impact.time < 45e-9:
        advance_window(impact)
    body = convert(cloud_of(domains), what.splat_element_size, what.splat_method).bodies[0]
    domains.particle.close()
    m, n = len(body.tets), len(body.points)
    # free of stress: what is left to see is what the motion itself does
    state = BodyState(
        body.points, body.tets, np.zeros((m, 6)), np.asarray(body.eps_p), np.full(m, 300.0), np.ones(m), np.zeros((n, 3)), np.zeros(n),
        float(domains.particle.mass.sum()), domains.particle.law,
    )  # fmt: skip
    domain = domain_of(state, "splat1")
    splat = Target(domain.mesh, domain.laws, domain.elements.T, fixed=(), sleeping=False)
    splat.take(domain.nodes, domain.elements, splat)
    arm = splat.x - splat.mass @ splat.x / splat.mass.sum()
    omega = np.array([0.0, 2.0 * np.pi / TURN, 0.0])
    splat.v[:] = np.array([0.0, 0.0, -500.0]) + np.cross(omega, arm)
    rim = omega[1] * float(np.max(np.hypot(arm[:, 0], arm[:, 2])))
    centrifugal = float(domain.laws["rho"][0]) * rim**2
    kinetic, momentum, strain = splat.kinetic(), splat.momentum(), splat.eps_p.copy()
    elastic, spin, steps = splat.elastic(), spin_of(splat), 0
    while splat.time < TURN:
        dt = min(splat.stable_dt(1.0)[0], 0.1 * (TURN - splat.time) + 1e-15)
        for _ in range(10):
            splat.advance(dt)
            splat.finish()
        steps += 10
    energy = splat.kinetic() + splat.elastic() - elastic + float(splat.sums[0] + splat.sums[1])
    drift = energy / kinetic - 1.0
    error = float(np.linalg.norm(splat.momentum() - momentum) / np.linalg.norm(momentum))
    wrong = []
    if abs(drift) > 1e-6:
        wrong.append(f"energy off by {drift:+.1e}")
    if error > 1e-12:
        wrong.append(f"momentum off by {error:.1e}")
    if (turn := float(np.linalg.norm(spin_of(splat) - spin) / np.linalg.norm(spin))) > 1e-9:
        wrong.append(f"angular momentum off by {turn:.1e}")
    if (grown := float(np.max(splat.eps_p - strain))) > 0.0:
        wrong.append(f"plastic strain grew by {grown:.1e}")
    now = splat.x - splat.mass @ splat.x / splat.mass.sum()
    young = float(9.0 * domain.laws["K"][0] / (3.0 * domain.laws["K"][0] / domain.laws["G"][0] + 1.0))
    if (bent := radius_change(now, arm)) > centrifugal / young:
        wrong.append(f"shape off by {bent:.1e} of its radius")
    return {
        "points": m, "steps": steps, "end ns": f"{splat.time * 1e9:.1f}", "drift": f"{drift:+.1e}", "momentum": f"{error:.0e}",
    }, wrong  # fmt: skip


def radius_change(now: np.ndarray, before: np.ndarray) -> float:
    """By how much (n,3) points about their centre have moved from others but for a rotation, over the largest radius (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(now.T @ before)
    keep = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    away = np.linalg.norm(now - before @ (u @ keep @ vt).T, axis=1)
    return float(away.max() / np.linalg.norm(before, axis=1).max())


def spin_of(splat: Target) -> np.ndarray:
    """Angular momentum (3,) about the centre of mass, kg m2/s."""
    centre = splat.mass @ splat.x / splat.mass.sum()
    return splat.mass @ np.cross(splat.x - centre, splat.velocity())


SPECIAL: dict[str, Callable[[Path], tuple[dict[str, object], list[str]]]] = {
    "Ni 1000 m/s at 45 degrees, restarted in the middle": restarted,
    "a splat in rigid motion": flying,
}


def page_part(rows: list[Row]) -> list[str]:
    """Checks, counts, the table, and the rows that failed or needed a retry."""
    passed = [row for row in rows if row["verdict"] == "passes"]
    retried = sum(bool(int(row["rescues"] or 0)) for row in rows)
    shown = [name for name in COLUMNS if name not in ("why", "cpu s")]
    lines = [CHECKS, f"**{len(passed)} of {len(rows)} pass**, {retried} of all had to be rescued. {versions(rows)}", ""]
    lines += markdown(shown, ([marked(row["scene"], row), *(row[name] for name in shown[1:])] for row in rows))
    for heading, chosen in (
        ("What fails, in the words of the check:", [row for row in rows if row not in passed]),
        ("What passes, but had to be rescued:", [row for row in passed if row["why"]]),
    ):
        lines += ["", heading, "", *(f"- **{row['scene']}**: {row['why']}" for row in chosen)] if chosen else []
    return lines


def main() -> None:
    """Compute the scenes that the table lacks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="scenes with this text in their names, computed again")
    parser.add_argument("--docs", action="store_true", help="run nothing: write the page")
    a = parser.parse_args()
    scenes = battery()
    names = [*scenes, *SPECIAL]
    table = study_table("stability", COLUMNS, ("scene",), "make stability")
    for name in names if not a.docs else ():
        if a.only not in name or ((name,) in table and not a.only):
            continue
        started = clock.process_time()
        with tempfile.TemporaryDirectory() as folder:
            row, wrong = SPECIAL[name](Path(folder)) if name in SPECIAL else play(name, scenes[name], Path(folder))
        why = str(row.get("why") or "; ".join(wrong)).replace("\n", " ")
        verdict = {"scene": name, "verdict": "fails" if wrong else "passes"}
        new = table.add({**row, **verdict, "cpu s": f"{clock.process_time() - started:.0f}", "why": why})
        print(*filter(None, new.values()), sep=" | ", flush=True)
    rows = sorted(table.rows, key=lambda row: names.index(row["scene"]) if row["scene"] in names else len(names))
    write_parts(PAGES["stability"], {"table": page_part(rows)})
    failed = [row["scene"] for row in rows if row["verdict"] != "passes"]
    print(f"{len(rows) - len(failed)} of {len(rows)} pass" + "".join(f"\n  fails: {name}" for name in failed))


if __name__ == "__main__":
    main()
