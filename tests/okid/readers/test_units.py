"""Units: factors from their definitions (exact by NIST SP 811, appendix B), rules for what means two things."""

import re
import subprocess
import sys

import numpy as np
import pytest

from okid.errors import IdentificationWarning, UnreadableFileError
from okid.readers import describe_file, read_record, units
from okid.readers.table import unique_names
from okid.readers.units import convert_unit, split_header, unit_error

# NIST SP 811 (2008), appendix B.8: exact factors.
INCH, POUND, GRAVITY = 0.0254, 0.45359237, 9.80665


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


@pytest.mark.parametrize("written", ["", "-", "1"])
def test_no_unit(written):
    assert str(convert_unit("channel", written)) == "channel: no unit in the file"


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
        ("gyro[0]", ("gyro[0]", "")),
        ("Y[1]", ("Y[1]", "")),
        ("xyz [2]", ("xyz [2]", "")),
        ("ratio [1]", ("ratio", "1")),
        ("bad\x1b[31mname", ("bad [31mname", "")),
    ],
)
def test_headers(header, expected):
    assert split_header(header) == expected


def test_columns_of_one_name_keep_their_headers():
    assert unique_names(["a", "a", "b", ""], ["a [m]", "a [m/s]", "b [m]", ""]) == ["a [m]", "a [m/s]", "b", "column_3"]


def test_units_already_in_si_do_not_cost_the_import_of_pint():
    code = (
        "import sys; from okid.readers.units import convert_unit, split_header, unit_error\n"
        "convert_unit('a', 'm/s^2'); convert_unit('a', 'g'); convert_unit('a', ''); print('pint' in sys.modules)\n"
        "convert_unit('a', 'kip'); print('pint' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


POUND_FORCE, TURN = 4.4482216152605, 2 * np.pi / 60


# Headers as programs and test stands in three languages write them: LabVIEW, HBM, RCbenchmark, Dewesoft, Siemens.
# Factors by definition (NIST SP 811; horsepower and knots from theirs), so no line repeats what the reader says.
HEADERS = {
    (1.0, "m/s^2"): (
        "Beschleunigung [m/s²]|Accélération [m/s2]|AI A-1 [m/s2]|ACC1@X [m/s2]|Point1:+Z (m/s^2)|Acc [m/s/s]|"
        "Accel X (m/s²)|Acc [m/sec^2]|Acc [ms^-2]|Beschl. [m/s^2]|channel [m/s^2]|channel [m/s2]|channel [m/s²]|"
        "channel [m s-2]|acc [ms2]|acc [mss]|Accél. (m.s⁻²)|a1 [m/sec2]|acc [ms-2]|acc [m/s/s]|"
        "acc (m/s2)|acc [m·s⁻²]|acc [m/s²]"
    ),
    (GRAVITY, "m/s^2"): (
        "Beschleunigung (g)|Accélération (g)|Vibration (g)|Acc X (g)|cDAQ1Mod1_ai0 [g]|Acceleration_0 (g)|AI 1 [g]|"
        "AI 1 (g)|Point1:+Z [g]|Acc [G]|Acc [gee]|Acc {g}|Acc <g>|Acc Y (g)|tip [g]|tip [G]|tip [gn]|acc_1 [g]|"
        "acc_1 [G]|acc_1 [gn]|ground [g]|ground [G]|ground [gn]|floor 3 [g]|floor 3 [G]|floor 3 [gn]|AccX [g]|"
        "AccX [G]|AccX [gn]|G-Force (G)|g force [g]|acc【g】|acc （g）|acc［g］"
    ),
    (GRAVITY / 1000, "m/s^2"): ("Accel X (mg)|Acc [mg]|tip [mg]|acc_1 [mg]|ground [mg]|floor 3 [mg]|AccX [mg]"),
    (INCH, "m/s^2"): ("Acceleration [in/s2]|Acceleration [in/s^2]"),
    (0.01, "m/s^2"): ("Acc [cm/s²]|Acc [Gal]|Acc [gal]|channel [cm/s^2]|channel [cm/s/s]|channel [Gal]"),
    (1e-05, "m/s^2"): ("Acc [mGal]"),
    (0.3048 / 60, "m/s"): ("Climb (fpm)|Climb [ft/min]"),
    (0.001, "m"): ("Weg [mm]|Déplacement [mm]|Displacement (mm)"),
    (1e-06, "m"): ("Displacement [µm]|Weg [µm]|Weg [um]|Weg [Mikrometer]|channel [µm]"),
    (INCH / 1000, "m"): (
        "Displacement [mil]|Displacement [mils]|Weg [thou]|disp [mil]|disp [mils]|disp (mil)|disp [thou]|disp <mil>|"
        "disp {mil}"
    ),
    (INCH, "m"): ("Displacement (in)|Displacement [inch]|LVDT (inches)|Stroke [in.]|channel [in]"),
    (1.0, "m/s"): ("Airspeed (m/s)|Geschwindigkeit (m/s)|Vitesse [m/s]"),
    (0.001, "m/s"): ("Velocity [mm/s]|Schwinggeschwindigkeit [mm/s]"),
    (INCH, "m/s"): ("Velocity [ips]|Velocity (in/s)|channel [in/s]|vel [ips]|vel (in/s)|vel [in/s]|vel {in/s}"),
    (1 / 3.6, "m/s"): ("Geschwindigkeit [km/h]|GPS speed [km/h]|Vitesse (km/h)"),
    (1609.344 / 3600, "m/s"): ("Airspeed (mph)|Speed [mph]"),
    (1852 / 3600, "m/s"): ("Airspeed (kts)|Fahrt [kn]"),
    (1.0, "N"): ("Kraft [N]|Schub [N]|Poussée (N)|Thrust (N)|MX840_CH1 [N]|hammer:+X (N)|Gewichtskraft [N]"),
    (1000 * GRAVITY, "N"): ("load (tf)"),
    (1000.0, "N"): ("Force (kn)|Force [kN]|Kraft (kN)|channel [kN]"),
    (10.0, "N"): ("Effort [daN]|Kraft [daN]"),
    (GRAVITY, "N"): ("Thrust (kgf)|Kraft [kp]|thrust [kgf]|thrust (kgf)|thrust [kp]"),
    (GRAVITY / 1000, "N"): ("Thrust (gf)|Thrust [gf]|thrust [gf]|thrust (gf)"),
    (POUND * GRAVITY, "N"): (
        "Thrust (lbf)|Force (lbf)|Load [lb]|Load [lbs]|Kraft [lb]|Hammer [lb]|Force [pound-force]|channel [lbf]|"
        "force [lbf]|force [lbs]|force [lb]|Load cell [lbf]|Load cell [lbs]|Load cell [lb]"
    ),
    (1000 * POUND * GRAVITY, "N"): ("Load [kip]|channel [kip]"),
    (0.001, "kg"): (
        "Schub [g]|Poussée [g]|Weight [g]|Mass [g]|Schubkraft [g]|Gewicht [g]|Poids [g]|Masse [g]|Thrust (g)|"
        "Effort [g]|Fuerza [g]|Peso [g]|Weight (grams)|thrust [g]|Motor Thrust [g]|mass [g]|weight_left [g]|"
        "load cell [g]|force [g]"
    ),
    (1.0, "kg"): ("Masse [kg]|Mass (kg)"),
    (1000.0, "kg"): ("Masse [t]"),
    (POUND, "kg"): ("Weight [lb]"),
    (POUND / 16, "kg"): ("Weight [oz]"),
    (2 * np.pi / 60, "rad/s"): (
        "Drehzahl [1/min]|Drehzahl [U/min]|Drehzahl (min-1)|Vitesse [tr/min]|Tacho [rpm]|tacho1 (rpm)|"
        "Vitesse de rotation (tr/min)|Motor Electrical Speed (RPM)|Motor Optical Speed (RPM)|speed [r/min]|n [1/min]|"
        "Drehzahl [min⁻¹]|Umdrehungen [1/min]|Régime [tr/mn]|speed [rev/min]|channel [rpm]|channel [rev/min]|"
        "speed [RPM]|speed [rpm]|speed [1/min]|speed [U/min]|speed [tr/min]|Motor Electrical Speed (U/min)|"
        "Drehzahl (RPM)|Drehzahl (U/min)|Speed [r.p.m.]|Spindle speed (rev/min)"
    ),
    (np.pi / 180, "rad/s"): (
        "Winkelgeschwindigkeit [°/s]|Rate [deg/s]|Rate [dps]|Gyro X (°/s)|Gyro (dps)|channel [deg/s]|rate [dps]|"
        "rate [°/s]|rate [deg/s]|rate (deg/s)"
    ),
    (np.pi / 180, "rad"): ("Winkel [°]|Winkel [Grad]|ángulo (grados)|Angle [deg]|Angle (°)|channel [deg]|channel [°]"),
    (np.pi / 180, "rad/s^2"): ("Angular acc [°/s²]|Angular acc [deg/s^2]"),
    (1.0, "rad/s"): ("Gyro X (rad/s)|Omega [rad/s]"),
    (1.0, "N m"): (
        "Couple (N.m)|Torque (N-m)|Mz [N•m]|Drehmoment [Nm]|Drehmoment (N·m)|Couple [N.m]|Torque (N·m)|Torque (N⋅m)|"
        "Torque [N m]|channel [N m]|channel [Nm]"
    ),
    (1000.0, "N m"): ("Moment [kNm]|Moment [kN·m]|channel [kNm]"),
    (0.001, "N m"): ("Moment [Nmm]|Moment [mNm]"),
    (POUND * GRAVITY * INCH, "N m"): (
        "Torque (lbf·in)|Torque [lb·in]|Torque [in-lbs]|Torque [in-lb]|Torque [lbf-in]|channel [lbf*in]|"
        "torque [in-lb]|torque [in-lbf]|torque [lbf in]"
    ),
    (POUND * GRAVITY * INCH / 16, "N m"): (
        "torque [ozin]|Torque (ozf·in)|Torque [oz-in]|torque [oz-in]|torque (ozf-in)"
    ),
    (12 * POUND * GRAVITY * INCH, "N m"): ("Moment [lb-ft]|Moment [ft-lb]"),
    (100000.0, "Pa"): ("Druck [bar]|Pression [bar]"),
    (100.0, "Pa"): ("Pressure [hPa]|Pressure [mbar]"),
    (1000.0, "Pa"): ("Pressure [kPa]|Druck (kPa)|p [kPa]|p {kPa}|p <kPa>|p (kPa)"),
    (POUND * GRAVITY / INCH**2, "Pa"): ("Pressure [psi]|Pressure (psi)|channel [psi]"),
    (1000000.0, "Pa"): ("Stress [MPa]|Stress [N/mm²]|Stress [N/mm2]|Spannung [N/mm²]"),
    (1.0, "Pa"): ("Sound Pressure (Pa)|mic:S (Pa)"),
    (1000.0, "N/m"): ("Stiffness [N/mm]|Stiffness [kN/m]|channel [N/mm]"),
    (1.0, "N/m"): ("Feder [N/m]"),
    (1.0, "V"): (
        "Spannung [V]|Tension [V]|Voltage (V)|Dev1/ai0 (V)|Dev1_ai0 (Volts)|Ausgang [Volt]|Untitled [V]|channel [V]"
    ),
    (0.001, "V"): ("Load Cell Thrust (mV)|AI 3 [mV]|channel [mV]"),
    (1.0, "A"): ("Strom [A]|Current (A)"),
    (0.001, "A"): ("Courant [mA]|Current [mA]"),
    (1000.0, "W"): ("Leistung [kW]"),
    (1.0, "W"): ("Electrical Power (W)|Mechanical Power (W)"),
    (75 * GRAVITY, "W"): ("Power [PS]"),
    (550 * 12 * INCH * POUND * GRAVITY, "W"): ("Power [hp]"),
    (3600000.0, "J"): ("Energy [kWh]"),
    (1e-06, "s"): ("ESC signal (µs)|Throttle (µs)|channel [µs]|channel [us]"),
    (1.0, "Hz"): ("Frequency [Hz]|Frequenz (Hz)|channel [Hz]"),
    (0.001 / 60, "m^3/s"): ("Débit [l/min]|Flow [L/min]"),
    (12 * INCH, "m"): ("channel [ft]"),
    (1000.0, "J"): ("channel [kJ]"),
    (1000.0, "Hz"): ("channel [kHz]"),
    (0.001, "s"): ("channel [ms]"),
    (60.0, "s"): ("channel [min]"),
}

KEPT = (
    "Dehnung [µm/m]|Déformation [µdef]|Motor Efficiency (%)|CH 1 [mV/V]|Strain [um/m]|Displacement [mils pp]|"
    "Charge [C]|Field [G]|Accel X (LSB)|Flow [gpm]|Level [dB]|Level [dB(A)]|Ratio [%]|Count [counts]|x [M]|"
    "Acc [G's]|Acc [g rms]|Acc [g's]|Acc [gE]|Dehnung [‰]|Strain [ue]|Strain [microstrain]|Schall [dB]|"
    "Inertia [kgm2]|Tank [gal]|Velocity [mm/s rms]|Displacement [µm pk-pk]|Acceleration [g pk]|Masse [gr]|"
    "Ch 3 [lb]|AI 4 [1/min]|T3 [F]|Strain [µe]|Charge [pC]|Gain [mV/g]|Count [cts]|Feuchte [%rF]|Amplitude [EU]|"
    "Flow [gal/min]|"
    "RH [%RH]|Acc [g²/Hz]|X [(g)]|Acc [g/s]|channel [counts]|channel [raw]|channel [%]|channel [dB]|"
    "channel [mV/V]|channel [LSB]|channel [foo/bar]|channel [9^9^9^9]|channel [os.system('x')]|"
    "magnetic field [G]|strain [ue]|strain [µε]|phase [U]|gain [a.u.]|x [bananas]|level [dB]|"
    "acc [MM/S2]|F [NEWTON]|acc [M/S2]|F [kn]|stiffness [kn/mm]|load (ton)|load (klb)"
)
"""What no reader can turn into SI: the values stay as they are, and it is said."""

NO_BRACKETS = (
    "Kraft / kN|Point1:+Z g|Acceleration, g|Disp, mm|speed_rpm|accel_g|disp_mm|Weg mm|Drehzahl rpm|Torque Nmm|"
    "pos_deg|Druck bar|Gyro dps|Thrust gf|Tension mV|Effort, daN|rpm|Thrust (gf) raw|Acc [g] filtered|Acc.g|"
    "Acc-g|ax_mg|speed RPM|Speed_rpm|acc_g|disp, mm|thrust gf|angle/deg|"
    "acc_g_1|acc_g_12|acc_g1|rpm1|force_kN_2|mm_3|Disp mil pp|v mph|torque_ozin|WegMM|ACC_G|accG|a_mps2|a_ms2|acc_mss|"
    "mm Weg|Weg:mm|acc=g|acc–g|acc 'g'|force \"kN\"|acc [m/s^2|acc (g rms)|vel (mm/s RMS)|Probe X (mil pk-pk)|"
    "p_MPA|disp_in|temp_F|temp degC|Winkel °|a m/s² RMS|Drehzahl U/min 2|torque_Nm|acc_g_x|gyro_dps_Y|pos_mm_z"
)
"""A unit behind a name may be a part of it: the values stay as they are, and it is said."""

PLAIN = (
    "Voltage_0|Amplitude - cDAQ1Mod1_ai0|Y_Value|Wegaufnehmer (induktiv)|Sensor (links)|tip (left)|"
    "Sonde (droite)|tip|tip (1)|sensor_A|floor_2|node_m|top min|ch_in|"
    "a1|input|sensor_m|x_in|Probe A|motor_A|phase_a|force|position|velocity_x|node 12|left|gyro_x|temp|A1|V1|m2|s1|"
    "g1|N12|MX840_CH1|Sensor F|node_G|temp_c|motor_temp C1|left_foot|temp_min|top max|Kp|x_bar|bar_1|acc_NS|acc_EW|"
    "ft_1|ch 1|disp_rad|second|channel N|PS1|hp_out|hammer:+X|Dev1/ai0|accX|vbat|sensor 3 F|in|out|n|T|t|h|L|Kraft|Weg|"
    "g_x|g level|mag_x|gyro x|c_x"
)


def test_the_table_of_headers_is_long_enough():
    spellings = [header for headers in (*HEADERS.values(), KEPT, NO_BRACKETS, PLAIN) for header in headers.split("|")]
    assert len(spellings) == len(set(spellings)) >= 200


@pytest.mark.parametrize(("truth", "headers"), HEADERS.items(), ids=lambda value: str(value)[:30])
def test_headers_of_programs_are_read_right(truth, headers):
    for header in headers.split("|"):
        conversion = convert_unit(*split_header(header))
        assert (conversion.unit, conversion.offset) == (truth[1], 0.0), header
        assert conversion.factor == pytest.approx(truth[0], rel=1e-9), header
        assert conversion.changed is (abs(truth[0] - 1) > 1e-9), header


@pytest.mark.parametrize(("headers", "said"), [(KEPT, "kept as it is"), (NO_BRACKETS, "values are kept as they are")])
def test_headers_that_are_not_read_are_said(headers, said):
    for header in headers.split("|"):
        conversion = convert_unit(*split_header(header))
        assert not conversion.changed, header
        assert conversion.unit == split_header(header)[1], header
        assert said in str(conversion), header


@pytest.mark.parametrize("header", ["Weg|mm", "force |kN|"])
def test_a_bar_cuts_a_unit_off(header):
    assert "the name ends in" in convert_unit(header, "").note


@pytest.mark.parametrize("header", ["Force (kg)", "Thrust (kg)", "Kraft [kg]", "Load [t]"])
def test_a_mass_under_a_name_of_a_force_is_doubted(header):
    conversion = convert_unit(*split_header(header))
    assert (conversion.unit, conversion.doubtful) == ("kg", True)
    assert "write kgf if it is one" in str(conversion)


@pytest.mark.parametrize(
    ("header", "doubtful"),
    [
        *(("Acc [MM/S2]", True), ("Force kN", True), ("F [kn]", True), ("Level [bananas]", True), ("Ch 3 [lb]", True)),
        *(("Count [counts]", False), ("RH [%]", False), ("Acc [g]", False), ("Strain [µm/m]", False), ("tip", False)),
        *(("thrust [g]", False), ("Gewichtskraft [kg]", False), ("Mass [kg]", False), ("Disp [mil]", False)),
    ],
)
def test_doubtful_is_what_may_be_in_another_unit_than_the_record_says(header, doubtful):
    assert convert_unit(*split_header(header)).doubtful is doubtful


def test_what_g_was_taken_for_is_said():
    assert "standard gravity" in str(convert_unit("tip", "g"))
    assert "gram" in str(convert_unit("mass", "g"))


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
        (GRAVITY, "g taken for m/s^2"),
        (1 / GRAVITY, "m/s^2 taken for g or newton taken for kilogram-force, a factor of 9.80665"),
        (2 * np.pi / 60, "revolutions per minute taken for rad/s, a factor of 9.5493"),
        (1e-3, "a thousandth (mm, mV, gram) taken for the unit itself, a factor of 1000"),
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


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("Weg in mm", "mm"),
        ("Effort en kN", "kN"),
        ("Drehzahl in min-1", "min-1"),
        ("a / m/s²", "m/s²"),
        ("Kraft/N", "N"),
        ("Vibration mm/s", "mm/s"),
        ("force N", "N"),
    ],
)
def test_a_unit_at_the_end_of_a_name_without_brackets_is_said(header, unit):
    name, written = split_header(header)
    assert (name, written) == (header, "")
    assert f"the name ends in {unit!r}" in convert_unit(name, written).note


@pytest.mark.parametrize(
    "header", ["channel A", "side N", "tip/hammer", "left in out", "re/im", "cDAQ1Mod1/ai0", "x/t"]
)
def test_a_name_that_only_looks_like_one_is_left_alone(header):
    assert not convert_unit(header, "").note


def test_parentheses_of_loggers_are_units_that_are_not_read_and_a_level_is_no_current():
    assert "kept as it is" in convert_unit(*split_header("strain (ue)")).note
    assert split_header("a (mG)") == ("a", "mG")
    assert split_header("dB(A)") == ("dB(A)", "")


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (
            "Time [s],tip [mm]\ns,m\n",
            "'tip' is in 'mm' by its own header and in 'm' by the row of units; 'm' was taken",
        ),
        (
            "s,m\nTime [s],tip [mm]\n",
            "'tip' is in 'mm' by its own header and in 'm' by the row of units; 'mm' was taken",
        ),
        ("Time [ms],tip\ns,m\n", "'Time' is in 'ms' by its own header and in 's' by the row of units; 's' was taken"),
        ("Time [s],tip [mm]\ns,mm\n", ""),
        ("Time [s],tip [mm]\ns,Millimeter\n", ""),
        ("Time [s],tip (left)\ns,mm\n", ""),
        *((f"Time,tip ({letter})\ns,g\n", "") for letter in "VAC"),  # vertical, axial, the third sensor
        ("s,g\nTime,tip (V)\n", ""),
        ("Time,tip (V)\ns,mV\n", "'tip' is in 'V' by its own header and in 'mV' by the row of units; 'mV' was taken"),
    ],
)
def test_a_row_of_units_that_contradicts_a_name_is_said(tmp_path, head, said):
    path = tmp_path / "a.csv"
    path.write_text(head + "".join(f"{k / 100:.2f},{k % 7}\n" for k in range(60)))
    if not said:
        assert not describe_file(path).doubts
        assert read_record(path).output_units == ("m/s^2" if "g" in head else "m",)
        return
    assert said in describe_file(path).remarks
    with pytest.warns(IdentificationWarning, match=re.escape(f"a.csv: {said}.")):
        record = read_record(path)
    taken = re.search(r"'(\w+)' was taken", said)[1]
    if "'tip'" in said:
        assert record.outputs[1, 0] == {"m": 1.0, "mm": 1e-3, "mV": 1e-3}[taken]
    else:
        assert record.dt == pytest.approx(0.01)
