"""How much a force does at each line of a spectrum, against the sine of that line in continuous time."""

import re

import numpy as np
import pytest
import scipy

from modal.discrepancy.diagnosis import diagnose
from modal.discrepancy.noise.spectral import most_heard
from modal.simulation.scheme import scheme_and_slopes
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import structural_plant
from okid.record import Record

MASS, STIFFNESS, DAMPING, DT, N = 1.3, 400.0, 2.0, 0.02, 200


def gains(kind, stiffness, step):
    """Of the force that does most, and of sines, by output over force, (n_lines,) each."""
    model = StructuralModel(
        np.array([[MASS]]), np.array([[DAMPING]]), np.array([[stiffness]]), force_map=np.array([[1.0]]),
        sensor_map=np.array([[1.0]]), sensor_kind=kind,
    )  # fmt: skip
    plant = structural_plant(model)
    scheme, _ = scheme_and_slopes(plant, plant.nominal, DT / step)
    (column,) = plant.port("element_0").columns
    s = 2j * np.pi * np.arange(1, N // 2) / (N * DT)
    sine = {"displacement": 1.0, "velocity": s, "acceleration": s**2}[kind] / (MASS * s**2 + DAMPING * s + stiffness)
    return np.sqrt(most_heard(scheme, N, step)[:, 0, column]), np.abs(sine)


@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_in_fine_steps_a_force_does_what_a_sine_does(kind):
    most, sine = gains(kind, STIFFNESS, 40)
    np.testing.assert_allclose(most, sine, rtol=0.01)


@pytest.mark.parametrize(
    ("kind", "stiffness"),
    [("displacement", STIFFNESS), ("velocity", STIFFNESS), ("velocity", 0.0)],
)
def test_no_line_is_deaf_to_a_force(kind, stiffness):
    """At the highest line a speed is to one that runs straight from sample to sample, a displacement to a held one."""
    most, sine = gains(kind, stiffness, 1)
    assert np.all(most > 0.6 * sine)
    assert np.all(most < 1.7 * sine)


def controlled(rng, n_samples=600, noise=0.005):
    """Records of a motor whose speed a controller holds to three slow set points: its noise is in the drive, too."""
    b, a = scipy.signal.butter(2, 0.04)
    target = scipy.signal.lfilter(b, a, rng.standard_normal((3, n_samples)), axis=1)
    target *= np.array([[0.6], [2.0], [1.2]]) / target.std(axis=1, keepdims=True)
    read, speed, total = np.empty((2, *target.shape)), np.zeros(3), np.zeros(3)
    for k in range(n_samples):
        read[1, :, k] = speed + noise * rng.standard_normal(3)
        missing = target[:, k] - read[1, :, k]
        total = total + DT * missing
        read[0, :, k] = drive = 4.0 * missing + 3.0 * total
        for _ in range(20):
            speed = speed + DT / 20 * (drive - 0.4 * speed - 0.15 * np.tanh(speed / 0.003))
    return [Record(u, y, DT) for u, y in read.transpose(1, 0, 2)]


def test_the_force_that_would_look_like_noise_is_what_moves_the_speed_so():
    records = controlled(np.random.default_rng(2))
    motor = StructuralModel(
        np.array([[1.0]]), np.array([[0.48]]), np.array([[0.0]]), force_map=np.array([[1.0]]),
        sensor_map=np.array([[1.0]]), sensor_kind="velocity",
    )  # fmt: skip
    found = diagnose(motor, records[:2], records[2:])
    assert [one.effect for one in found.findings] == ["coulomb_friction"]
    (size,) = re.findall(r"a force that nobody measured, of (\S+) N at element_0", " ".join(found.warnings))
    assert float(size) == pytest.approx(np.sqrt(2.0) * 0.005 / DT, rel=0.3)  # from one reading to the next
