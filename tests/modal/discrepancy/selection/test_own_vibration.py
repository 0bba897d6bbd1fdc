"""A hung mass that swings by itself in every record proves nothing: two sines of a machine, and a true absorber."""

import numpy as np
import pytest
import scipy

from modal.discrepancy.diagnosis import diagnose
from modal.effects.catalogue import CATALOGUE
from modal.structure.structural_model import StructuralModel
from okid.record import Record

MASS, STIFFNESS, DAMPING = 1.2, 900.0, 1.0
DT, N_SAMPLES = 0.01, 700
LEVELS = (1.0, 5.0, 2.5)


def along(A, B, drives, start):
    """(n_samples, n_states) of each record, the drives (n_samples, n_inputs) held between samples."""
    F, G, *_ = scipy.signal.cont2discrete((A, B, np.eye(len(A)), np.zeros_like(B)), DT)
    found = np.empty((len(drives), len(drives[0]), len(A)))
    for states, drive in zip(found, drives, strict=True):
        x = np.array(start)
        for k, u in enumerate(drive):
            states[k], x = x, F @ x + G @ u
    return found


def records_of(rng, drives, places):
    """Records of what was measured, sensor noise of a hundredth added."""
    noisy = places + 0.01 * places.std(axis=1, keepdims=True) * rng.standard_normal(places.shape)
    return [Record(u[:, 0], y, DT) for u, y in zip(drives, noisy, strict=True)]


def shaken(rng, n_samples=N_SAMPLES):
    """(n_records, n_samples) of broadband force at three levels."""
    b, a = scipy.signal.butter(2, 0.3)
    waves = scipy.signal.lfilter(b, a, rng.standard_normal((3, n_samples)), axis=1)
    return 40.0 * np.array(LEVELS)[:, None] * waves / waves.std()


def named(records):
    """The diagnosis by hung masses and sines."""
    model = StructuralModel.chain(
        [MASS], [1.03 * STIFFNESS], [0.8 * DAMPING], force_dofs=[0], sensor_dofs=[0], sensor_kind="displacement"
    )
    catalogue = {key: CATALOGUE[key] for key in ("missing_mode", "periodic_disturbance")}
    return diagnose(model, fit=records[:2], held_out=records[2:], catalogue=catalogue)


def machine(seed):
    """Records of one mass under a rotor out of balance: a sine and its second harmonic, begun alike in each record."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * 3.5 * DT * np.arange(N_SAMPLES)
    rotor = 20.0 * np.sin(angle + 0.4) + 10.0 * np.sin(2 * angle + 1.0)
    drives = np.stack([shaken(rng), np.tile(rotor, (3, 1))], axis=2)
    A = np.array([[0.0, 1.0], [-STIFFNESS / MASS, -DAMPING / MASS]])
    states = along(A, np.array([[0.0, 0.0], [1.0, -1.0]]) / MASS, drives, [0.0, 0.0])
    return records_of(rng, drives, states[:, :, :1])


def absorber(seed, ratio=0.01, damping=0.003):
    """Records of one mass with a light one hung on it, cut while both move, beside a sine."""
    rng = np.random.default_rng(seed)
    n_samples = 2 * N_SAMPLES
    sine = 20.0 * np.sin(2 * np.pi * 3.5 * DT * np.arange(-N_SAMPLES, N_SAMPLES) + 0.4)
    drives = np.stack([shaken(rng, n_samples), np.tile(sine, (3, 1))], axis=2)
    w, m = 2 * np.pi * 7.0, ratio * MASS
    k, c = m * w**2, 2 * m * damping * w
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-(STIFFNESS + k) / MASS, -(DAMPING + c) / MASS, k / MASS, c / MASS],
            [0.0, 0.0, 0.0, 1.0],
            [k / m, c / m, -k / m, -c / m],
        ]
    )
    states = along(A, np.array([[0.0, 0.0], [1.0, -1.0], [0.0, 0.0], [0.0, 0.0]]) / MASS, drives, np.zeros(4))
    return records_of(rng, drives[:, N_SAMPLES:], states[:, N_SAMPLES:, :1])


@pytest.mark.parametrize("seed", [1, 2])
def test_no_mass_is_named_where_a_vibration_that_no_motion_drives_does_as_well(seed):
    found = named(machine(seed))
    assert found.status == "unresolved"
    hung = next(one for one in found.findings if one.effect == "missing_mode")
    assert ("free_vibration", "element_0") in hung.runner_up.effects
    assert hung.evidence.margin <= 0.0
    assert any("free vibration at element_0" in one for one in found.warnings)


def test_a_light_absorber_is_named_though_it_swings_when_the_records_begin():
    found = named(absorber(3))
    assert (found.status, {one.effect for one in found.findings}) == ("named", {"missing_mode", "periodic_disturbance"})
    hung = next(one for one in found.findings if one.effect == "missing_mode")
    assert hung.parameters[0].value == pytest.approx(0.01, rel=0.05)
    assert hung.evidence.margin > 100.0
