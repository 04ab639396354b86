"""Strips whose curvature is known in closed form."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from coupler.properties.strip import NAMES, Strip, write

H, E, NU = 1.29e-3, 200e9, 0.3  # an Almen strip A


def strip(layers: int, thickness: float, stress: float = 0.0, ratio: float = 1.0, expansion: float = 0.0) -> Strip:
    """A strip of one slice under equal layers. ratio: of their modulus to that of the strip; expansion: of the layers alone."""

    def column(of_strip: float, of_layers: float) -> np.ndarray:
        return np.append(of_strip, np.full(layers, of_layers))

    return Strip(
        column(H, thickness / layers), column(E, ratio * E), column(NU, NU), column(0.0, stress), column(0.0, expansion)
    )


def test_a_thin_layer_bends_the_strip_as_stoney_says() -> None:
    """Stoney (1909), Proc. R. Soc. A 82, 172, for a plate: -6 sigma h (1 - nu) / (E H^2); compression makes the coated side convex.
    The layer has a thousandth of the thickness: its own stiffness changes some 4 h / H."""
    h, stress = 1e-3 * H, -100e6
    coated = strip(1, h, stress)
    bend = coated.deposited()[1]
    assert bend == pytest.approx(-6.0 * stress * h * (1.0 - NU) / (E * H**2), rel=5e-3)
    assert coated.values(0.1)["deflection_m"] == pytest.approx(bend * 0.1**2 / 8.0)
    assert bend > 0.0


@pytest.mark.parametrize(("m", "n"), [(0.1, 1.0), (0.5, 0.4), (2.0, 3.0)])
def test_misfit_bends_a_bimetal_as_timoshenko_says(m: float, n: float) -> None:
    """Timoshenko (1925), J. Opt. Soc. Am. 11, 233: both assume plane sections, so that they are equal to rounding. m: ratio of
    thicknesses, n: of moduli. No force and no moment is left: with one slice each, the strain in the middles gives the stress."""
    strain, bimetal = 1e-3, strip(1, m * H, ratio=n, expansion=1e-3)
    stress, bend = bimetal.misfit()
    total = H * (1.0 + m)
    exact = 6.0 * strain * (1.0 + m) ** 2 / (total * (3.0 * (1.0 + m) ** 2 + (1.0 + m * n) * (m**2 + 1.0 / (m * n))))
    assert bend == pytest.approx(exact, rel=1e-12)
    assert stress @ bimetal.height == pytest.approx(0.0, abs=1e-9 * abs(stress).max() * H)


def test_layers_that_become_thinner_approach_steady_growth() -> None:
    """A coating that grows on a strip of its own modulus: d kappa = -6 sigma dh / (M (H + h)^2), so that kappa = -6 sigma / M
    (1 / H - 1 / (H + h)). A layer of n bends the section that includes it: the error halves where n doubles."""
    h, stress = 0.6 * H, 80e6
    exact = -6.0 * stress * (1.0 - NU) / E * (1.0 / H - 1.0 / (H + h))
    errors = [abs(strip(n, h, stress).deposited()[1] / exact - 1.0) for n in (50, 100, 200)]
    assert errors[2] < 6e-3
    assert np.diff(np.log2(errors)) == pytest.approx([-1.0, -1.0], abs=0.05)


def test_what_is_left_bears_no_force_and_no_moment() -> None:
    """Of many layers; the linear part within a slice of the strip is left out of the table, so that it is cut into many."""
    n = 400
    fine = Strip(
        *(
            np.append(np.full(n, a), np.full(n, b))
            for a, b in ((H / n, 0.3 * H / n), (E, 0.5 * E), (NU, 0.2), (0.0, -50e6), (0.0, 5e-4))
        ),
        n,
    )
    residual, _, _ = fine.residual()
    load, z = residual * fine.height, fine.middle - H
    assert abs(load.sum()) < 1e-6 * abs(load).sum()
    assert abs(load @ z) < 1e-4 * (abs(load) @ abs(z))


def test_a_strip_held_flat_needs_the_moment_of_its_curvature() -> None:
    """The stress in the file for other programs: when it is released, the strip bends as the layers have bent it. What is linear
    within a slice is not in it: 1e-4."""
    bent = strip(20, 0.4 * H, -80e6, 0.5, 2e-4)
    _, flat, curvature = bent.residual()
    assert (flat * bent.height).sum() == pytest.approx(0.0, abs=1e-9 * (abs(flat) @ bent.height))
    assert bent.relaxed(flat * bent.height)[1] == pytest.approx(curvature, rel=1e-4)


def test_the_file_for_other_programs_has_a_stress_for_each_point(tmp_path: Path) -> None:
    """meshio reads the mesh; after it each brick has eight lines: element, point, six components (CalculiX manual, *INITIAL
    CONDITIONS). The comments for Abaqus say the same of the sets."""
    path, coated = tmp_path / NAMES[1], strip(3, 60e-6, -80e6)
    write(coated, 20e-3, tmp_path, "")
    mesh = meshio.read(path)
    assert mesh.points[:, 2].max() == pytest.approx(H + 60e-6)
    inside = path.read_text().split("TYPE=STRESS\n")[1].split("*STEP")[0]
    values = np.array([[float(cell) for cell in line.split(",")] for line in inside.splitlines()])
    assert len(values) == 8 * len(mesh.cells[0].data)
    slice_of = ((values[:, 0] - 1) % 4).astype(int)
    np.testing.assert_allclose(values[:, 2], coated.residual()[1][slice_of], rtol=1e-6)
    assert (values[:, 4:] == 0.0).all()
    told = [line.split(", ") for line in path.read_text().splitlines() if line.startswith("** SLICE")]
    assert [name for name, *_ in told] == [f"** {name}" for name in mesh.cell_sets]
    of_slices = np.array([line[1:] for line in told], float)
    np.testing.assert_array_equal(of_slices[slice_of], values[:, 2:])
