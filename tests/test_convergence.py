"""The fit of orders of convergence (workflows/convergence.py): what it finds, and that it says so when there is nothing to find."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

N = np.array([1000.0, 2000, 4000, 8000, 16000, 32000])


@pytest.fixture(scope="module")
def study() -> ModuleType:
    path = Path(__file__).parents[1] / "workflows" / "convergence.py"
    spec = importlib.util.spec_from_file_location("convergence", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_an_order_that_is_there_is_found_with_its_limit(study: ModuleType, order: float) -> None:
    exact = 5.0 - 0.7 * (N / 1000) ** (-order / 3)
    fit = study.fit_order(N, exact)
    assert fit["order"] == pytest.approx(order, abs=0.02)
    assert fit["limit"] == pytest.approx(5.0, abs=0.03)
    assert fit["scatter"] < 1e-3
    noisy = exact + 2e-3 * np.array([1, -1, 0.5, -0.5, 1, -1])
    fit = study.fit_order(N, noisy)
    assert fit["order_low"] < order < fit["order_high"]


def test_a_known_limit_is_kept(study: ModuleType) -> None:
    fit = study.fit_order(N, 0.07 * (N / 1000) ** (-0.44 / 3), limit=0.0)
    assert fit["limit"] == 0.0
    assert fit["order"] == pytest.approx(0.44, abs=0.02)
    assert fit["order_high"] - fit["order_low"] < 0.05


def test_scatter_and_endless_growth_have_no_order(study: ModuleType) -> None:
    scatter = study.fit_order(N, 5.0 + 0.01 * np.array([1, -1, 1, -1, -1, 1]))
    assert scatter["order_low"] == study.ORDERS[0]
    assert scatter["order_high"] == study.ORDERS[-1]
    growth = study.fit_order(N, np.log(N))
    assert growth["order_low"] == study.ORDERS[0]
    with pytest.raises(ValueError, match="at least 4 resolutions, not 3"):
        study.fit_order(N[:3], N[:3])


def test_the_table_of_orders_comes_from_the_ladder_alone(study: ModuleType, tmp_path: Path) -> None:
    rows = []
    for n in N:
        row = {name: "1" for name in study.COLUMNS} | {"points": f"{n:g}", "failed": ""}
        row |= {name: str(usual) for name, usual in study.DEFAULTS.items()}
        row |= {m: str(5.0 - 0.7 * (n / 1000) ** (-1 / 3)) for m, _, limit in study.MEASURES if limit is None}
        row |= {m: str(0.07 * (n / 1000) ** (-0.5 / 3)) for m, _, limit in study.MEASURES if limit is not None}
        rows.append(row)
    plain = study.orders(rows)
    assert plain[2].startswith("| flattening, greatest | 4.3 | 4.7")
    assert "| 1 | " in plain[2]
    assert "| 0.5 | " in plain[-1]
    knob = {**rows[2], "hourglass": "0.1", "flattening_gd": "9"}
    turned = {**rows[2], "lattice": "bcc", "flattening_gd": "9"}
    failed = {**rows[2], "points": "500", "failed": "crushed", "flattening_gd": ""}
    assert study.orders([*rows[::-1], knob, turned, failed]) == plain
    assert study.orders(rows[:3]) == ["No orders: they need 4 resolutions at least, and there are 3."]
    docs = tmp_path / "docs.md"
    docs.write_text(f"before\n{study.BEGIN}\nold\n{study.END}\nafter\n")
    study.write_orders(rows, docs)
    study.write_orders(rows, docs)
    assert docs.read_text() == "\n".join(["before", study.BEGIN, "", *plain, "", study.END, "after", ""])
    docs.write_text("nothing")
    with pytest.raises(SystemExit, match="has no place for the orders"):
        study.write_orders(rows, docs)


def test_rows_are_told_apart_by_points_and_knobs(study: ModuleType) -> None:
    plain = study.key_of({"points": "4000"})
    assert plain == study.key_of(
        {"points": 4000, "kernel_radius": "0.75", "Q1": 0.06, "lattice": "fcc", "hourglass": ""}
    )
    others = [study.key_of({"points": 4000, **knob}) for knob in study.KNOBS]
    assert len({plain, *others}) == len(others) + 1


def test_another_lattice_lasts_as_long_as_it_is_asked_for(study: ModuleType) -> None:
    usual = study.shapes.shape("sphere", 25e-6, 300).points
    with study.packed_on("bcc"):
        other = study.shapes.shape("sphere", 25e-6, 300).points
    assert other.shape != usual.shape or not np.allclose(other, usual)
    assert np.array_equal(study.shapes.shape("sphere", 25e-6, 300).points, usual)
