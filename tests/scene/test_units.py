import math

import pytest

from coupler import units


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("25 um", "length", 25e-6),
        ("25um", "length", 25e-6),
        ("25 µm", "length", 25e-6),
        ("-1.5e1 mm", "length", -15e-3),
        (".5 km/s", "velocity", 500.0),
        ("20 degC", "temperature", 293.15),
        ("20 °C", "temperature", 293.15),
        ("500 C", "temperature", 773.15),
        ("1 min", "time", 60.0),
        ("180 deg", "angle", math.pi),
        ("60 ns", "time", 60e-9),
        ("0.9 GPa", "pressure", 0.9e9),
        ("8.906 g/cm^3", "density", 8906.0),
        ("456 J/(kg K)", "specific heat", 456.0),
        ("1 1/s", "rate", 1.0),
    ],
)
def test_reads_exactly(text, dimension, value):
    assert units.parse(text, dimension) == value


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (25, "needs a length with its unit"),
        (True, "needs a length with its unit"),
        ("25", "has no unit"),
        ("25 m/s", "is a velocity: needs a length"),
        ("25 umm", 'did you mean "um"'),
        ("1 minute", "unknown unit"),
        ("um", "is not a number with a unit"),
        ("nan m", "is not a number"),
        ("inf m", "is not a number"),
        ("1e999 m", "unknown unit"),
        ("1__0 m", "unknown unit"),
        ("9" * 100 + " m", "is not a number"),
    ],
)
def test_says_what_is_wanted(value, says):
    with pytest.raises(units.UnitError, match="needs a length") as caught:
        units.parse(value, "length")
    assert says in str(caught.value)


@pytest.mark.parametrize("unit", ["um", "nm", "degC", "K", "deg", "ns", "MPa", "J/(kg K)"])
@pytest.mark.parametrize("value", [2.5e-5, 1.2693645e-6, 293.15, 0.1 + 0.2, 0.0, -1 / 3, 1e9])
def test_what_is_shown_reads_back_to_the_same_float(value, unit):
    assert units.parse(units.show(value, unit), units.dimension_of(unit)) == value


def test_shown_as_people_write_it():
    assert units.show(25e-6, "um") == "25 um"
    assert units.show(200e-6, "um") == "200 um"
    assert units.show(293.15, "degC") == "20 degC"
    assert units.rounded(1.26936e-6, "um") == "1.27 um"
    assert units.rounded(5e-3, "um") == "5000 um"


def test_nearest():
    assert units.nearest("velocty", ["velocity", "angle"]) == ' (did you mean "velocity"?)'
    assert units.nearest("xyz", ["velocity"]) == ""
