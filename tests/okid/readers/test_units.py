"""Units: factors from their definitions (exact by NIST SP 811, appendix B), rules for what means two things."""

import subprocess
import sys

import numpy as np
import pytest

from okid.errors import UnreadableFileError
from okid.readers import units
from okid.readers.table import split_header, unique_names
from okid.readers.units import convert_unit, unit_error

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


def test_a_units_library_that_does_not_work_is_said(monkeypatch):
    """As an old one beside a new parser: every unit would count as unknown, and be kept as it is in silence."""

    def broken():
        raise TypeError("cannot inherit frozen dataclass from a non-frozen one")

    monkeypatch.setattr("pint.UnitRegistry", broken)
    units._registry.cache_clear()
    with pytest.raises(UnreadableFileError, match=r"pint does not work here \(cannot inherit .*run: pip install"):
        convert_unit("speed", "km/h")


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
        "import sys; from okid.readers.units import convert_unit, unit_error\n"
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


# Headers as programs and test stands in three languages write them: LabVIEW, HBM, RCbenchmark, Dewesoft, Siemens.
# Factors by definition (NIST SP 811; horsepower and knots from theirs), so no line repeats what the reader says.
HEADERS = {
    (
        1.0,
        "m/s^2",
    ): "Beschleunigung [m/s²]|Accélération [m/s2]|AI A-1 [m/s2]|ACC1@X [m/s2]|Point1:+Z (m/s^2)|Acc [m/s/s]"
    "|Accel X (m/s²)|Acc [m/sec^2]|Acc [ms^-2]|Beschl. [m/s^2]",
    (
        GRAVITY,
        "m/s^2",
    ): "Beschleunigung (g)|Accélération (g)|Vibration (g)|Acc X (g)|cDAQ1Mod1_ai0 [g]|Acceleration_0 (g)"
    "|AI 1 [g]|AI 1 (g)|Point1:+Z [g]|Acc [G]|Acc [gee]|Acc {g}|Acc <g>|Acc Y (g)",
    (GRAVITY / 1000, "m/s^2"): "Accel X (mg)|Acc [mg]",
    (INCH, "m/s^2"): "Acceleration [in/s2]|Acceleration [in/s^2]",
    (0.01, "m/s^2"): "Acc [cm/s²]|Acc [Gal]|Acc [gal]",
    (1e-5, "m/s^2"): "Acc [mGal]",
    (1e-3, "m"): "Weg [mm]|Déplacement [mm]|Displacement (mm)",
    (1e-6, "m"): "Displacement [µm]|Weg [µm]|Weg [um]|Weg [Mikrometer]",
    (INCH / 1000, "m"): "Displacement [mil]|Displacement [mils]|Weg [thou]",
    (INCH, "m"): "Displacement (in)|Displacement [inch]|LVDT (inches)|Stroke [in.]",
    (1.0, "m/s"): "Airspeed (m/s)|Geschwindigkeit (m/s)|Vitesse [m/s]",
    (1e-3, "m/s"): "Velocity [mm/s]|Schwinggeschwindigkeit [mm/s]",
    (INCH, "m/s"): "Velocity [ips]|Velocity (in/s)",
    (1 / 3.6, "m/s"): "Geschwindigkeit [km/h]|GPS speed [km/h]|Vitesse (km/h)",
    (1609.344 / 3600, "m/s"): "Airspeed (mph)|Speed [mph]",
    (1852 / 3600, "m/s"): "Airspeed (kts)|Fahrt [kn]",
    (1.0, "N"): "Kraft [N]|Schub [N]|Poussée (N)|Thrust (N)|MX840_CH1 [N]|hammer:+X (N)|Gewichtskraft [N]",
    (1000.0, "N"): "Force [kN]|Kraft (kN)",
    (10.0, "N"): "Effort [daN]|Kraft [daN]",
    (GRAVITY, "N"): "Thrust (kgf)|Kraft [kp]",
    (GRAVITY / 1000, "N"): "Thrust (gf)|Thrust [gf]",
    (POUND * GRAVITY, "N"): "Thrust (lbf)|Force (lbf)|Load [lb]|Load [lbs]|Kraft [lb]|Hammer [lb]|Force [pound-force]",
    (1000 * POUND * GRAVITY, "N"): "Load [kip]",
    (1e-3, "kg"): "Schub [g]|Poussée [g]|Weight [g]|Mass [g]|Schubkraft [g]|Gewicht [g]|Poids [g]|Masse [g]|Thrust (g)"
    "|Effort [g]|Fuerza [g]|Peso [g]|Weight (grams)",
    (1.0, "kg"): "Masse [kg]|Mass (kg)",
    (1000.0, "kg"): "Masse [t]",
    (POUND, "kg"): "Weight [lb]",
    (POUND / 16, "kg"): "Weight [oz]",
    (
        2 * np.pi / 60,
        "rad/s",
    ): "Drehzahl [1/min]|Drehzahl [U/min]|Drehzahl (min-1)|Vitesse [tr/min]|Tacho [rpm]|tacho1 (rpm)"
    "|Vitesse de rotation (tr/min)|Motor Electrical Speed (RPM)|Motor Optical Speed (RPM)|speed [r/min]"
    "|n [1/min]|Drehzahl [min⁻¹]|Umdrehungen [1/min]|Régime [tr/mn]"
    "|speed [rev/min]",
    (np.pi / 180, "rad/s"): "Winkelgeschwindigkeit [°/s]|Rate [deg/s]|Rate [dps]|Gyro X (°/s)|Gyro (dps)",
    (np.pi / 180, "rad"): "Winkel [°]|Winkel [Grad]|Angle [deg]|Angle (°)",
    (np.pi / 180, "rad/s^2"): "Angular acc [°/s²]|Angular acc [deg/s^2]",
    (1.0, "rad/s"): "Gyro X (rad/s)|Omega [rad/s]",
    (
        1.0,
        "N m",
    ): "Couple (N.m)|Torque (N-m)|Mz [N•m]|Drehmoment [Nm]|Drehmoment (N·m)|Couple [N.m]|Torque (N·m)|Torque (N⋅m)"
    "|Torque [N m]",
    (1000.0, "N m"): "Moment [kNm]|Moment [kN·m]",
    (1e-3, "N m"): "Moment [Nmm]|Moment [mNm]",
    (POUND * GRAVITY * INCH, "N m"): "Torque (lbf·in)|Torque [lb·in]|Torque [in-lbs]|Torque [in-lb]|Torque [lbf-in]",
    (POUND * GRAVITY * INCH / 16, "N m"): "Torque (ozf·in)|Torque [oz-in]",
    (12 * POUND * GRAVITY * INCH, "N m"): "Moment [lb-ft]|Moment [ft-lb]",
    (1e5, "Pa"): "Druck [bar]|Pression [bar]",
    (100.0, "Pa"): "Pressure [hPa]|Pressure [mbar]",
    (1000.0, "Pa"): "Pressure [kPa]|Druck (kPa)",
    (POUND * GRAVITY / INCH**2, "Pa"): "Pressure [psi]|Pressure (psi)",
    (1e6, "Pa"): "Stress [MPa]|Stress [N/mm²]|Stress [N/mm2]|Spannung [N/mm²]",
    (1.0, "Pa"): "Sound Pressure (Pa)|mic:S (Pa)",
    (1000.0, "N/m"): "Stiffness [N/mm]|Stiffness [kN/m]",
    (1.0, "N/m"): "Feder [N/m]",
    (1.0, "V"): "Spannung [V]|Tension [V]|Voltage (V)|Dev1/ai0 (V)|Dev1_ai0 (Volts)|Ausgang [Volt]|Untitled [V]",
    (1e-3, "V"): "Load Cell Thrust (mV)|AI 3 [mV]",
    (1.0, "A"): "Strom [A]|Current (A)",
    (1e-3, "A"): "Courant [mA]|Current [mA]",
    (1000.0, "W"): "Leistung [kW]",
    (1.0, "W"): "Electrical Power (W)|Mechanical Power (W)",
    (75 * GRAVITY, "W"): "Power [PS]",
    (550 * 12 * INCH * POUND * GRAVITY, "W"): "Power [hp]",
    (3.6e6, "J"): "Energy [kWh]",
    (1e-6, "s"): "ESC signal (µs)|Throttle (µs)",
    (1.0, "Hz"): "Frequency [Hz]|Frequenz (Hz)",
    (1e-3 / 60, "m^3/s"): "Débit [l/min]|Flow [L/min]",
}

KEPT = (
    "Dehnung [µm/m]|Déformation [µdef]|Motor Efficiency (%)|CH 1 [mV/V]|Strain [um/m]|Displacement [mils pp]|"
    "Charge [C]|Field [G]|Accel X (LSB)|Flow [gpm]|Level [dB]|Level [dB(A)]|Ratio [%]|Count [counts]|x [M]|"
    "Acc [G's]|Acc [g rms]|"
    "Acc [g's]|Acc [gE]|Dehnung [‰]|Strain [ue]|Strain [microstrain]|Schall [dB]|Inertia [kgm2]|"
    "Tank [gal]|Velocity [mm/s rms]|Displacement [µm pk-pk]|Acceleration [g pk]|"
    "Masse [gr]|Ch 3 [lb]|AI 4 [1/min]|T3 [F]|Strain [µe]|Charge [pC]|Gain [mV/g]|Count [cts]|Feuchte [%rF]|"
    "Amplitude [EU]|RH [%RH]|Acc [g²/Hz]|X [(g)]|Acc [g/s]"
)
"""What no reader can turn into SI: the values stay as they are, and it is said."""

NO_BRACKETS = (
    "Kraft / kN|Point1:+Z g|Acceleration, g|Disp, mm|speed_rpm|accel_g|disp_mm|Weg mm|Drehzahl rpm|Torque Nmm|pos_deg|"
    "Druck bar|Gyro dps|Thrust gf|Tension mV|Effort, daN|rpm|Thrust (gf) raw|Acc [g] filtered|Acc.g|Acc-g|ax_mg"
)
"""A unit behind a name may be a part of it: the values stay as they are, and it is said."""

PLAIN = "Voltage_0|Amplitude - cDAQ1Mod1_ai0|Y_Value|Wegaufnehmer (induktiv)|Sensor (links)|tip (left)|Sonde (droite)"


def test_the_table_of_headers_is_long_enough():
    spellings = [header for headers in (*HEADERS.values(), KEPT, NO_BRACKETS, PLAIN) for header in headers.split("|")]
    assert len(spellings) == len(set(spellings)) >= 200


@pytest.mark.parametrize(("truth", "headers"), HEADERS.items(), ids=lambda value: str(value)[:30])
def test_headers_of_programs_are_read_right(truth, headers):
    for header in headers.split("|"):
        conversion = convert_unit(*split_header(header))
        assert (conversion.unit, conversion.offset) == (truth[1], 0.0), header
        assert conversion.factor == pytest.approx(truth[0], rel=1e-5), header


@pytest.mark.parametrize(("headers", "said"), [(KEPT, "kept as it is"), (NO_BRACKETS, "values are kept as they are")])
def test_headers_that_are_not_read_are_said(headers, said):
    for header in headers.split("|"):
        conversion = convert_unit(*split_header(header))
        assert not conversion.changed, header
        assert said in str(conversion), header


def test_names_that_hold_no_unit_are_left_alone():
    for header in PLAIN.split("|"):
        assert split_header(header) == (header, "")
        assert convert_unit(header, "").note == ""


@pytest.mark.parametrize(
    ("header", "factor", "ice"),
    [
        ("Temp (C)", 1.0, 0.0),
        ("Temp (F)", 5 / 9, 32.0),
        ("Temperatur [°C]", 1.0, 0.0),
        ("T [Grad C]", 1.0, 0.0),
        ("T [℃]", 1.0, 0.0),
    ],
)
def test_temperatures_of_loggers(header, factor, ice):
    conversion = convert_unit(*split_header(header))
    assert (conversion.unit, conversion.factor) == ("K", pytest.approx(factor))
    assert conversion.factor * ice + conversion.offset == pytest.approx(273.15)


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (GRAVITY, "g taken for m/s"),
        (1 / GRAVITY, "1 / 9.80665"),
        (60 / (2 * np.pi), "revolutions"),
        (1e-3, "thousandth"),
        (25.4, "inches"),
        (4.4482216, "pound-force"),
        (-9.81, "g taken for m/s"),
    ],
)
def test_a_gain_of_a_conversion_is_named_where_it_is_surely_known(gain, words):
    assert words in unit_error(gain * 1.0003, 3e-4 * abs(gain))
    assert unit_error(gain, 0.2 * abs(gain)) == ""
    assert unit_error(1.05 * gain, 3e-4 * abs(gain)) == ""


def test_chance_names_an_error_of_units_as_seldom_as_promised():
    """Gains from 1e-4 to 1e4, as likely at one power of ten as at another, known to half a per cent."""
    gains = np.exp(np.random.default_rng(1).uniform(-np.log(1e4), np.log(1e4), 4000))
    assert sum(unit_error(gain, 0.005 * gain) != "" for gain in gains) <= 0.05 * 4000
