"""The two stories of a missing effect: their records against other integrators, what they find against the truth."""

import importlib
import re

import numpy as np
import pytest

from modal.examples import loose_joint, many_records, motor_propeller, story, three_storey_frame
from modal.examples.loose_joint import Frame
from modal.examples.motor_propeller import Motor
from modal.examples.struck_mass import StruckMass
from modal.report.writing import DiagnosisFiles
from okid.errors import InvalidDataError

# --- the motor and its propeller -------------------------------------------------------------------------------------


def exact_speed(motor, start, voltage, time):
    """J w' = kt u - b w - c2 w^2 for w > 0, a Riccati equation with constant coefficients in closed form."""
    a, b, c = (x / motor.inertia for x in (motor.torque * voltage, motor.loss, motor.drag))
    root = np.sqrt(b**2 + 4 * a * c)
    high, low = (-b + root) / (2 * c), (-b - root) / (2 * c)
    share = (start - high) / (start - low) * np.exp(-root * time)
    return (high - low * share) / (1 - share)


def test_the_motor_is_integrated_right():
    motor = Motor(noise=0)
    record = motor_propeller.measured_record(
        motor, np.random.default_rng(4), voltages=(1.0, 12.0), name="run", n_samples=300
    )
    speeds, volts = record.outputs[:, 0], record.inputs[:, 0]
    following = exact_speed(motor, speeds[:-1], volts[:-1], motor.dt)
    np.testing.assert_allclose(speeds[1:], following, rtol=1e-7)
    assert 4 < np.count_nonzero(np.diff(volts)) < 30  # it holds each voltage for 10 samples or more


def test_the_motor_story_finds_the_drag_and_the_loss():
    """Only what is hidden is asked for: the effect, and both values within 4 of their standard deviations."""
    motor = Motor()
    diagnosis = motor_propeller.study(motor, np.random.default_rng(77))
    assert diagnosis.status == "named"
    assert [(one.effect, one.where) for one in diagnosis.findings] == [("quadratic_drag", "element_0")]
    drag, std = story.parameter(diagnosis, "quadratic_drag", "c2")
    assert abs(drag - motor.drag) < 4 * std < 0.2 * motor.drag
    (loss,) = diagnosis.calibrated
    assert abs(loss.value - motor.loss) < 4 * loss.std
    levels = [step.held_out_level for step in diagnosis.steps]
    assert levels == sorted(levels, reverse=True)
    assert levels[-1] < 1.5 < levels[-2]
    text = motor_propeller.summary(motor, diagnosis)
    assert "hidden 2.4000" in text
    assert "given 1173, hidden 766" in text
    with pytest.raises(InvalidDataError, match="found no gap_spring"):
        story.parameter(diagnosis, "gap_spring", "gap")


# --- the frame -------------------------------------------------------------------------------------------------------


def test_the_frame_is_integrated_right():
    """Against 64 Runge-Kutta steps a sample, on equations that are written out storey by storey."""
    frame, level, n_samples = Frame(noise=0), 25.0, 60
    record = loose_joint.frame_record(frame, np.random.default_rng(6), level=level, name="run", n_samples=n_samples)
    again = np.random.default_rng(6)  # the same draws: 120 frequencies, 120 phases, then the start
    pulses = 2 * np.pi * again.uniform(0.5, 25.0, 120)
    phases = again.uniform(0.0, 2 * np.pi, 120)
    x, v = level * 1e-5 * again.standard_normal(3), level * 5e-4 * again.standard_normal(3)

    def force(t):
        return level * np.sqrt(2 / 120) * np.sin(pulses * t + phases).sum()

    def acceleration(x, v, f):
        loads = []
        for e, (k, c) in enumerate(zip(frame.stiffnesses, frame.dampings, strict=True)):
            d, rate = (x[e], v[e]) if e == 0 else (x[e] - x[e - 1], v[e] - v[e - 1])
            tight = k - frame.brace if e == frame.loose else k
            beyond = max(abs(d) - frame.play, 0.0) * np.sign(d) if e == frame.loose else 0.0
            loads.append(tight * d + frame.brace * beyond + c * rate)
        m = frame.masses
        return np.array([(loads[1] - loads[0]) / m[0], (loads[2] - loads[1]) / m[1], (f - loads[2]) / m[2]])

    wanted, step = [], frame.dt / 64
    for k in range(n_samples):
        t = k * frame.dt
        wanted.append(acceleration(x, v, force(t)))
        for j in range(64):
            f = [force(t + (j + part) * step) for part in (0.0, 0.5, 1.0)]
            a1 = acceleration(x, v, f[0])
            a2 = acceleration(x + step / 2 * v, v + step / 2 * a1, f[1])
            a3 = acceleration(x + step / 2 * (v + step / 2 * a1), v + step / 2 * a2, f[1])
            a4 = acceleration(x + step * (v + step / 2 * a2), v + step * a3, f[2])
            x = x + step * v + step**2 / 6 * (a1 + a2 + a3)
            v = v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    np.testing.assert_allclose(record.inputs[:, 0], [force(k * frame.dt) for k in range(n_samples)], atol=1e-12)
    np.testing.assert_allclose(record.outputs, wanted, atol=1e-5 * np.abs(wanted).max())


def test_a_short_frame_story_finds_storey_play_and_stiffness(tmp_path, monkeypatch, capsys):
    """Less than a second a record, through the command, with the files."""
    frame, whole = Frame(), loose_joint.study
    found = []

    def short(given, rng):
        found.append(whole(given, rng, n_samples=200))
        return found[0]

    monkeypatch.setattr(loose_joint, "study", short)
    assert loose_joint.main(["-o", str(tmp_path / "out"), "--seed", "78"]) == 0
    check_loose_joint(frame, found[0])
    said = capsys.readouterr().out
    assert "loose joint in storey_2, hidden in storey_2" in said
    assert all(path.is_file() and str(path) in said for path in DiagnosisFiles.in_folder(tmp_path / "out"))


def check_loose_joint(frame, diagnosis):
    """Place, and all values within 4 of their standard deviations (or a part in a thousand, where those are less)."""
    assert diagnosis.status == "named"
    assert [(one.effect, one.where) for one in diagnosis.findings] == [("gap_spring", "storey_2")]
    play, play_std = story.parameter(diagnosis, "gap_spring", "gap")
    inner, inner_std = story.parameter(diagnosis, "gap_spring", "k_in")
    outer, _ = story.parameter(diagnosis, "gap_spring", "k_out")
    storey = next(one for one in diagnosis.calibrated if one.name == "stiffness of storey_2")
    assert abs(play - frame.play) < max(4 * play_std, 1e-3 * frame.play)
    assert abs(outer - inner - frame.brace) < max(4 * inner_std, 1e-3 * frame.brace)
    assert storey.value + outer == pytest.approx(frame.stiffnesses[1], rel=1e-3)
    assert diagnosis.steps[-1].held_out_level < 1.5


@pytest.fixture(scope="module")
def page(repository):
    return (repository / "modal" / "docs" / "gallery.md").read_text(encoding="utf-8")


def test_the_nine_stories_can_be_run(page):
    modules = set(re.findall(r"python -m (modal\.examples\.\w+)", page))
    assert len(modules) == 9
    assert all(callable(importlib.import_module(module).main) for module in modules)


def test_every_section_has_a_small_picture_and_every_link_a_target(page, repository):
    pictures = re.findall(r"!\[[^\]]+\]\((pictures/\w+\.png)\)", page)
    sections = page.split("\n## ")[1:]
    commands_alone = [one for one in sections if one.startswith("From one file to a cluster")]
    assert len(commands_alone) == 1
    assert len(pictures) == len(set(pictures)) == len(sections) - 1 == 10
    for link in [*pictures, *re.findall(r"\]\(([\w./]+)\)", page)]:
        assert (repository / "modal" / "docs" / link).is_file(), link
    for picture in pictures:
        file = repository / "modal" / "docs" / picture
        assert file.read_bytes()[:4] == b"\x89PNG"
        assert file.stat().st_size < 150_000
    titles = {re.sub(r"[^\w-]", "", title.lower().replace(" ", "-")) for title in re.findall(r"\n## (.+)", page)}
    assert set(re.findall(r"\]\(#([\w-]+)\)", page)) == titles


def test_the_frame_of_the_page_is_the_frame_of_the_truth(page):
    truth = three_storey_frame.truth()
    rows = re.findall(r"^ +(\d) +([\d.]+) +([\d.]+) +([\d.]+) % +([\d.]+) % +([\d.]+)$", page, re.MULTILINE)
    assert len(rows) == 4
    for number, found, frequency, damping, _, assurance in rows:
        assert float(frequency) == pytest.approx(truth.frequencies[int(number) - 1], abs=6e-5)
        assert float(found) == pytest.approx(float(frequency), rel=1e-3)
        assert float(damping) == pytest.approx(0.8, rel=0.1)
        assert float(assurance) > 0.999


def test_the_shifts_of_the_page_hold_the_true_ones(page):
    true = 100 * (many_records.modules(loss=many_records.ROW.loss).modes()[0] / many_records.modules().modes()[0] - 1)
    rows = re.findall(r"\| ([+-][\d.]+) ± ([\d.]+) % \| (.+) \|", page)
    assert len(rows) == many_records.ROW.n_modules
    for (shift, width, verdict), expected in zip(rows, true, strict=True):
        assert float(shift) == pytest.approx(expected, abs=2 * float(width))
        assert (verdict == "beyond chance") == (expected < -0.1)


def test_what_the_page_calls_hidden_is_hidden(page):
    motor, frame, mass = Motor(), Frame(), StruckMass()
    hidden = {float(value) for value in re.findall(r"hidden ([\d.]+)", page)}
    expected = {1e7 * motor.drag, 1e3 * motor.loss, 766, 1e3 * frame.play, frame.brace / 1e3, 60}
    assert {round(value, 4) for value in expected} == {round(value, 4) for value in hidden}
    assert f"(true {mass.frequency:.4f})" in page
    assert f"(true {mass.damping_ratio:.4f})" in page
    assert f"hidden: joint {many_records.ROW.loosened + 1}, {100 * many_records.ROW.loss:.2f} %" in page
