"""Frequency responses as an analyser makes them from a simulated test; nothing here imports okid, era or modal.

    from response_tables import table_of
    table = table_of(3, window="hann", n_samples=1024)

A structure of five modes (0.2 to 1.5 % damping, at least 8 % apart, between 0.03 and 0.4 of the sampling frequency) is
driven at two points by white forces, its six sensors have 5 % noise; or, "shaker" and "shakers", at one point or both
by shakers that it loads: the measured forces then dip at every resonance. Blocks are cut, windowed, transformed and
averaged (H1, multiple coherence). Truth: frequencies and damping ratios of the structure alone.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
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
    if kind != "white":
        points = drive[:1] if kind == "shaker" else drive
        forces, outputs = loaded_shakers(rng, f, zeta, shapes, points=points, length=length, fs=fs)
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


def loaded_shakers(rng, f, zeta, shapes, *, points, length, fs):
    """Forces at the points and accelerations under shakers whose moving masses hang on stingers; exact held steps."""
    n_modes, n_shakers = len(f), len(points)
    w = 2 * np.pi * f
    gains = shapes / w  # mass-normalised shapes whose accelerances are of one size
    mass = 0.3 / np.mean(gains[points] ** 2, axis=1)
    stiffness = mass * (2 * np.pi * 0.2 * fs) ** 2
    damping = 0.05 * np.sqrt(stiffness * mass)
    n = n_modes + n_shakers
    links = np.hstack([-gains[points], np.eye(n_shakers)])  # stretch of each stinger: armature less structure
    inertia = np.r_[np.ones(n_modes), mass]
    own = 2 * np.pi * 0.01 * fs  # of the armature in its suspension
    K = np.diag(np.r_[w**2, mass * own**2]) + links.T @ (stiffness[:, None] * links)
    C = np.diag(np.r_[2 * zeta * w, 0.3 * mass * own]) + links.T @ (damping[:, None] * links)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / inertia[:, None], -C / inertia[:, None]]])
    B = np.vstack([np.zeros((n + n_modes, n_shakers)), np.diag(1 / mass)])
    poles, vectors = np.linalg.eig(A)
    drive = np.linalg.solve(vectors, B + 0j)
    fine = length * OVERSAMPLING
    currents = np.fft.rfft(rng.standard_normal((n_shakers, fine)))
    currents[:, int(0.45 * length) :] = 0.0  # nothing above 0.45 of the sampling frequency, so that samples tell all
    currents = np.fft.irfft(currents, fine)
    dt = 1 / (fs * OVERSAMPLING)
    forces, outputs = np.zeros((length, n_shakers)), np.zeros((length, N_OUTPUTS))
    of_forces = np.hstack([stiffness[:, None] * links, damping[:, None] * links]) @ vectors
    of_outputs = gains @ A[n : n + n_modes] @ vectors
    for r, pole in enumerate(poles):
        held = np.exp(pole * dt)
        state = lfilter([0.0, (held - 1) / pole], [1.0, -held], drive[r] @ currents)[::OVERSAMPLING]
        forces += np.outer(state, of_forces[:, r]).real
        outputs += np.outer(state, of_outputs[:, r]).real
    return forces, outputs


def distorted_chain(seed, *, cubic=0.0, friction=0.0, n_samples=1024, n_records=16, fs=100.0):
    """Three masses in a row driven at the last, the first on a cubic spring or a rubbing joint; Hann, 2 % noise.

    Linear steps are exact, what is not linear is held over an eighth of a sample.
    """
    rng = np.random.default_rng([seed, 4117])
    stiffness = (2 * np.pi * rng.uniform(6, 12)) ** 2
    K = stiffness * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    squares, shapes = np.linalg.eigh(K)
    w = np.sqrt(squares)
    zeta = np.exp(rng.uniform(np.log(0.004), np.log(0.02), 3))
    C = shapes @ np.diag(2 * zeta * w) @ shapes.T
    force = np.zeros((6, 2))
    force[3, 0] = force[5, 1] = 1.0
    continuous = np.block([[np.zeros((3, 3)), np.eye(3)], [-K, -C]])
    held = expm(np.block([[continuous, force], [np.zeros((2, 8))]]) / (8 * fs))
    lines = 2 * np.pi * np.linspace(0.05, fs / 2, 4000)
    alone = np.abs([np.linalg.solve(K - x**2 * np.eye(3) + 1j * x * C, [0.0, 0.0, 1.0])[0] for x in lines])
    motion, speed = np.sqrt((alone**2).mean()), np.sqrt(((alone * lines) ** 2).mean())  # rms of the linear chain
    length = 6 * n_samples
    drive = rng.standard_normal((n_records, length))
    outputs = np.empty((n_records, length, 3))
    state = np.zeros((n_records, 6))
    for t in range(length):
        for _ in range(8):
            x, v = state[:, 0], state[:, 3]
            back = stiffness * (cubic * x**3 / motion**2 + friction * motion * np.tanh(50 * v / speed))
            state = state @ held[:6, :6].T + np.stack([-back, drive[:, t]], axis=1) @ held[:6, 6:].T
        outputs[:, t] = state[:, :3]
    outputs += 0.02 * outputs.std(axis=(0, 1)) * rng.standard_normal(outputs.shape)
    settled = slice(2 * n_samples, None)
    rows = drive[:, settled].reshape(-1, 1), outputs[:, settled].reshape(-1, 3)
    response, coherence, n_averages = averaged(*rows, "hann", n_samples, record=4 * n_samples)
    return AnalysedTest(
        response=response,
        frequencies=np.arange(n_samples // 2 + 1) * fs / n_samples,
        coherence=coherence,
        n_averages=n_averages,
        true_frequencies=w / (2 * np.pi),
        true_damping=zeta,
    )


def averaged(forces, outputs, window, n_samples, *, record=None, step=None):
    """H1 with multiple coherence: half overlap for windows that fade, none for a uniform one, unless told the step.

    Rows are records of so many samples, one after the other, which no block spans; all are one record unless given.
    """
    weight = windows.get_window("boxcar" if window == "uniform" else window, n_samples, fftbins=True)
    step = step or (n_samples if window == "uniform" else n_samples // 2)
    record = record or len(forces)
    starts = [k for k in range(0, len(forces) - n_samples + 1, step) if k % record + n_samples <= record]
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
