"""Frequency responses as an analyser makes them from a simulated test; nothing here imports okid, era or modal.

    from response_tables import table_of
    table = table_of(3, window="hann", n_samples=1024)

A structure of five modes (0.2 to 1.5 % damping, at least 8 % apart, between 0.03 and 0.4 of the sampling frequency) is
driven at two points by white forces, its six sensors have 5 % noise; or, "shaker", at one point by a shaker that it
loads: the measured force then dips at every resonance. Blocks are cut, windowed, transformed and averaged (H1, multiple
coherence). Truth: frequencies and damping ratios of the structure alone.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, windows

N_MODES, N_OUTPUTS, NOISE, OVERSAMPLING = 5, 6, 0.05, 8


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AnalysedTest:
    """What the analyser gives, and what is true."""

    response: np.ndarray
    frequencies: np.ndarray
    coherence: np.ndarray
    n_averages: int
    true_frequencies: np.ndarray
    true_damping: np.ndarray


def table_of(seed, *, window="hann", n_samples=1024, kind="white", length=65536, fs=100.0):
    """One test of the structure of this seed."""
    rng = np.random.default_rng([seed, 58])
    f, zeta, shapes = drawn_structure(rng, fs)
    drive = rng.choice(N_OUTPUTS, 2, replace=False)
    if kind == "shaker":
        forces, outputs = loaded_shaker(rng, f, zeta, shapes, point=int(drive[0]), length=length, fs=fs)
    else:
        forces = rng.standard_normal((length, 2))
        outputs = held_response(forces, f, zeta, shapes, shapes[drive], dt=1 / fs)
    outputs = outputs + NOISE * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    response, coherence, n_averages = averaged(forces, outputs, window, n_samples)
    return AnalysedTest(
        response=response,
        frequencies=np.arange(n_samples // 2 + 1) * fs / n_samples,
        coherence=coherence,
        n_averages=n_averages,
        true_frequencies=f,
        true_damping=zeta,
    )


def drawn_structure(rng, fs):
    """Frequencies [Hz], damping ratios, (n_outputs, n_modes) real shapes."""
    while True:
        f = np.sort(np.exp(rng.uniform(np.log(0.03), np.log(0.4), N_MODES))) * fs
        if (f[1:] / f[:-1] > 1.08).all():
            break
    return f, np.exp(rng.uniform(np.log(0.002), np.log(0.015), N_MODES)), rng.standard_normal((N_OUTPUTS, N_MODES))


def held_response(forces, f, zeta, shapes, inputs, *, dt):
    """Accelerations, over f^2 so that no mode dwarfs the others, to forces that are held over each sample."""
    outputs = np.zeros((len(forces), N_OUTPUTS))
    for r in range(len(f)):
        w = 2 * np.pi * f[r]
        s = -zeta[r] * w + 1j * w * np.sqrt(1 - zeta[r] ** 2)
        pole = np.exp(s * dt)
        gain = (pole - 1) / s / (2j * s.imag) * s**2
        motion = 2 * lfilter([0.0, gain], [1.0, -pole], forces @ inputs[:, r] + 0j).real + forces @ inputs[:, r]
        outputs += np.outer(motion / w, shapes[:, r])
    return outputs


def loaded_shaker(rng, f, zeta, shapes, *, point, length, fs):
    """Force at the point and accelerations under a shaker whose moving mass hangs on a stinger; exact held steps."""
    n_modes = len(f)
    w = 2 * np.pi * f
    gains = shapes / w  # mass-normalised shapes whose accelerances are of one size
    mass, stiffness, damping = 0.3 / np.mean(gains[point] ** 2), 0.0, 2.0
    stiffness = mass * (2 * np.pi * 0.2 * fs) ** 2
    damping = 0.05 * np.sqrt(stiffness * mass)
    n = n_modes + 1
    link = np.r_[-gains[point], 1.0]  # stretch of the stinger: armature less structure
    inertia = np.r_[np.ones(n_modes), mass]
    K = np.diag(np.r_[w**2, mass * (2 * np.pi * 0.01 * fs) ** 2]) + stiffness * np.outer(link, link)
    C = np.diag(np.r_[2 * zeta * w, 0.3 * mass * 2 * np.pi * 0.01 * fs]) + damping * np.outer(link, link)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / inertia[:, None], -C / inertia[:, None]]])
    b = np.r_[np.zeros(2 * n - 1), 1.0 / mass]
    poles, vectors = np.linalg.eig(A)
    drive = np.linalg.solve(vectors, b + 0j)
    fine = length * OVERSAMPLING
    current = np.fft.rfft(rng.standard_normal(fine))
    current[int(0.45 * length) :] = 0.0  # nothing above 0.45 of the sampling frequency, so that samples tell all
    current = np.fft.irfft(current, fine)
    dt = 1 / (fs * OVERSAMPLING)
    force, outputs = np.zeros(length), np.zeros((length, N_OUTPUTS))
    of_force = np.r_[stiffness * link, damping * link] @ vectors
    of_outputs = np.hstack([gains @ A[n : 2 * n - 1, :]]) @ vectors
    for r, pole in enumerate(poles):
        held = np.exp(pole * dt)
        state = lfilter([0.0, (held - 1) / pole * drive[r]], [1.0, -held], current + 0j)[::OVERSAMPLING]
        force += (of_force[r] * state).real
        outputs += (np.outer(state, of_outputs[:, r])).real
    return force[:, None], outputs


def averaged(forces, outputs, window, n_samples):
    """H1 with multiple coherence: half overlap for windows that fade, none for a uniform one."""
    weight = windows.get_window("boxcar" if window == "uniform" else window, n_samples, fftbins=True)
    step = n_samples if window == "uniform" else n_samples // 2
    starts = range(0, len(forces) - n_samples + 1, step)
    cut = np.array([np.hstack([forces[k : k + n_samples], outputs[k : k + n_samples]]) for k in starts])
    spectra = np.fft.rfft(cut * weight[:, None], axis=1)
    n_inputs = forces.shape[1]
    u, y = spectra[:, :, :n_inputs], spectra[:, :, n_inputs:]
    uu = np.einsum("bli,blj->lij", u, u.conj())
    yu = np.einsum("blq,bli->lqi", y, u.conj())
    response = np.linalg.solve(uu.transpose(0, 2, 1), yu.transpose(0, 2, 1)).transpose(0, 2, 1)
    power = (np.abs(y) ** 2).sum(axis=0)
    coherence = np.einsum("lqi,lqi->lq", response, yu.conj()).real / power
    return response, np.clip(coherence, 0, 1), len(starts)
