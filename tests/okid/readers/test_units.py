"""Units: factors from their definitions (exact by NIST SP 811, appendix B), rules for what means two things."""

import subprocess
import sys

import numpy as np
import pytest

from okid.readers.table import split_header, unique_names
from okid.readers.units import convert_unit

# NIST SP 811 (2008), appendix B.8: exact factors.
INCH, POUND, GRAVITY = 0.0254, 0.45359237, 9.80665


@pytest.mark.parametrize(
    ("written", "factor", "unit"),
    [
        ("m/s^2", 1.0, "m/s^2"),
        ("m/s2", 1.0, "m/s^2"),
        ("m/s²", 1.0, "m/s^2"),
        ("m s-2", 1.0, "m/s^2"),
        ("cm/s^2", 0.01, "m/s^2"),
        ("cm/s/s", 0.01, "m/s^2"),
        ("Gal", 0.01, "m/s^2"),
        ("in", INCH, "m"),
        ("in/s", INCH, "m/s"),
        ("ft", 12 * INCH, "m"),
        ("kip", 1000 * POUND * GRAVITY, "N"),
        ("lbf", POUND * GRAVITY, "N"),
        ("psi", POUND * GRAVITY / INCH**2, "Pa"),
        ("lbf*in", POUND * GRAVITY * INCH, "N m"),
        ("kN", 1000.0, "N"),
        ("N m", 1.0, "N m"),
        ("Nm", 1.0, "N m"),
        ("kNm", 1000.0, "N m"),
        ("kJ", 1000.0, "J"),
        ("N/mm", 1000.0, "N/m"),
        ("mV", 0.001, "V"),
        ("V", 1.0, "V"),
        ("deg", np.pi / 180, "rad"),
        ("°", np.pi / 180, "rad"),
        ("deg/s", np.pi / 180, "rad/s"),
        ("rpm", 2 * np.pi / 60, "rad/s"),
        ("rev/min", 2 * np.pi / 60, "rad/s"),
        ("Hz", 1.0, "Hz"),
        ("kHz", 1000.0, "Hz"),
        ("ms", 0.001, "s"),
        ("µs", 1e-6, "s"),
        ("us", 1e-6, "s"),
        ("min", 60.0, "s"),
        ("µm", 1e-6, "m"),
    ],
)
def test_factors_by_definition(written, factor, unit):
    conversion = convert_unit("channel", written)
    assert conversion.unit == unit
    assert conversion.factor == pytest.approx(factor, rel=1e-12)
    assert conversion.offset == 0.0
    assert conversion.changed is (abs(factor - 1) > 1e-9)


@pytest.mark.parametrize(("written", "celsius_20"), [("degC", 20.0), ("°C", 20.0), ("degF", 68.0), ("K", 293.15)])
def test_temperatures_have_an_offset(written, celsius_20):
    conversion = convert_unit("oil", written)
    assert conversion.unit == "K"
    assert conversion.factor * celsius_20 + conversion.offset == pytest.approx(293.15, abs=1e-9)


def test_a_rate_of_temperature_has_no_offset():
    conversion = convert_unit("oil", "degC/min")
    assert (conversion.unit, conversion.offset) == ("K/s", 0.0)
    assert conversion.factor == pytest.approx(1 / 60)


@pytest.mark.parametrize("written", ["counts", "raw", "%", "dB", "mV/V", "LSB", "foo/bar", "9^9^9^9", "os.system('x')"])
def test_what_is_no_unit_of_si_is_kept_and_said(written):
    conversion = convert_unit("channel", written)
    assert conversion.unit == written
    assert not conversion.changed
    assert "kept as it is" in str(conversion)


@pytest.mark.parametrize("written", ["", "-", "1"])
def test_no_unit(written):
    assert str(convert_unit("channel", written)) == "channel: no unit in the file"


@pytest.mark.parametrize("name", ["tip", "acc_1", "ground", "floor 3", "AccX"])
@pytest.mark.parametrize(("written", "factor"), [("g", 1.0), ("G", 1.0), ("mg", 1e-3), ("gn", 1.0)])
def test_g_is_gravity(name, written, factor):
    conversion = convert_unit(name, written)
    assert (conversion.unit, conversion.factor) == ("m/s^2", pytest.approx(factor * GRAVITY))
    assert "standard gravity" in str(conversion)


@pytest.mark.parametrize("name", ["thrust", "Motor Thrust", "mass", "weight_left", "load cell", "force"])
def test_g_is_gram_where_the_name_speaks_of_mass_or_force(name):
    conversion = convert_unit(name, "g")
    assert (conversion.unit, conversion.factor) == ("kg", pytest.approx(1e-3))
    assert "gram" in str(conversion)


def test_gauss_is_not_gravity():
    assert convert_unit("magnetic field", "G").unit == "G"


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("tip [m/s^2]", ("tip", "m/s^2")),
        ("tip[m/s^2]", ("tip", "m/s^2")),
        (" Time (s) ", ("Time", "s")),
        ("x (left)", ("x (left)", "")),
        ("x (left/right)", ("x (left/right)", "")),
        ("x (2)", ("x (2)", "")),
        ("x (c)", ("x (c)", "")),
        ("a (m/(s^2))", ("a", "m/(s^2)")),
        ("M (N m)", ("M", "N m")),
        ("a [any thing]", ("a", "any thing")),
        ("[V]", ("[V]", "")),
        ("plain", ("plain", "")),
        ("bad\x1b[31mname", ("bad [31mname", "")),
    ],
)
def test_headers(header, expected):
    assert split_header(header) == expected


def test_columns_of_one_name_keep_their_headers():
    assert unique_names(["a", "a", "b", ""], ["a [m]", "a [m/s]", "b [m]", ""]) == ["a [m]", "a [m/s]", "b", "column_3"]


def test_units_already_in_si_do_not_cost_the_import_of_pint():
    code = (
        "import sys; from okid.readers.units import convert_unit\n"
        "convert_unit('a', 'm/s^2'); convert_unit('a', 'g'); convert_unit('a', ''); print('pint' in sys.modules)\n"
        "convert_unit('a', 'kip'); print('pint' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


POUND_FORCE, TURN = 4.4482216152605, 2 * np.pi / 60


@pytest.mark.parametrize(
    ("header", "factor", "unit"),
    [
        *(
            (f"speed [{text}]", TURN, "rad/s")
            for text in ("RPM", "rpm", "r/min", "1/min", "U/min", "tr/min", "rev/min")
        ),
        *(
            (f"{name} ({text})", TURN, "rad/s")
            for name in ("Motor Electrical Speed", "Drehzahl")
            for text in ("RPM", "U/min")
        ),
        *((f"disp {text}", INCH / 1000, "m") for text in ("[mil]", "[mils]", "(mil)", "[thou]", "<mil>", "{mil}")),
        *((f"vel {text}", INCH, "m/s") for text in ("[ips]", "(in/s)", "[in/s]", "{in/s}")),
        *((f"thrust {text}", 9.80665e-3, "N") for text in ("[gf]", "(gf)")),
        *((f"thrust {text}", 9.80665, "N") for text in ("[kgf]", "(kgf)", "[kp]")),
        *((f"{name} [{text}]", POUND_FORCE, "N") for name in ("force", "Load cell") for text in ("lbf", "lbs", "lb")),
        *((f"torque [{text}]", INCH * POUND_FORCE, "N m") for text in ("in-lb", "in-lbf", "lbf in")),
        *((f"torque {text}", INCH * POUND_FORCE / 16, "N m") for text in ("[oz-in]", "(ozf-in)")),
        *((f"rate {text}", np.pi / 180, "rad/s") for text in ("[dps]", "[°/s]", "[deg/s]", "(deg/s)")),
        *((f"acc {text}", 1.0, "m/s^2") for text in ("[ms-2]", "[m/s/s]", "(m/s2)", "[m·s⁻²]", "[m/s²]")),
        *((f"p {text}", 1000.0, "Pa") for text in ("[kPa]", "{kPa}", "<kPa>", "(kPa)")),
    ],
)
def test_spellings_of_loggers_and_languages(header, factor, unit):
    name, written = split_header(header)
    found = convert_unit(name, written)
    assert found.factor == pytest.approx(factor, rel=1e-9)
    assert found.unit == unit


@pytest.mark.parametrize(
    "header", ["strain [ue]", "strain [µε]", "phase [U]", "gain [a.u.]", "x [bananas]", "level [dB]"]
)
def test_what_is_no_unit_is_kept_and_said(header):
    found = convert_unit(*split_header(header))
    assert found.factor == 1.0
    assert "kept as it is" in found.note


@pytest.mark.parametrize("header", ["speed RPM", "Speed_rpm", "acc_g", "disp, mm", "thrust gf", "angle/deg"])
def test_a_unit_without_brackets_is_not_read_and_said(header):
    found = convert_unit(*split_header(header))
    assert (found.factor, found.unit) == (1.0, "")
    assert "write it in brackets" in found.note


@pytest.mark.parametrize(
    "header", ["tip", "tip (left)", "tip (1)", "sensor_A", "floor_2", "node_m", "top min", "ch_in"]
)
def test_a_name_is_no_unit(header):
    found = convert_unit(*split_header(header))
    assert (found.factor, found.unit, found.note) == (1.0, "", "")
    assert split_header(header)[0] == header
