"""A hand-made result of a three-storey frame on a shake table: nothing here comes from the code under test."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_by_hand import make_diagnosis

from era.realisation import Realisation
from modal.identification.result import Identification, OrderEvidence
from modal.modes.mode import Choice, Fit, ModalModel, Mode
from modal.verdict.stabilisation import StabilisationPoint
from okid.excitation import Excitation
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.record import Record
from okid.residuals import ResidualCheck

DT = 0.01
N_SAMPLES = 3000
FREQUENCIES = (3.67, 11.1, 16.6)
DAMPINGS = (0.012, 0.009, 0.015)
SHAPES = np.array([[0.45, -1.0, 0.80], [0.80, -0.35, -1.0], [1.0, 0.85, 0.45]])
"""(n_outputs, n_modes)."""


@pytest.fixture(scope="session")
def identification():
    return make_identification()


@pytest.fixture(scope="session")
def diagnosis():
    """Two effects found and proved."""
    return make_diagnosis()


@pytest.fixture(scope="session")
def diagnosis_of():
    """A function of status and number of effects -> Diagnosis, each made once."""
    return functools.cache(lambda status, n_effects: make_diagnosis(status=status, n_effects=n_effects))


@pytest.fixture(scope="session")
def make_gap():
    """`make_diagnosis` itself, for names and changed fields."""
    return make_diagnosis


@pytest.fixture(scope="session")
def make_result():
    """A function of names and changed fields -> Identification."""
    return make_identification


def make_identification(*, names=("floor_1", "floor_2", "floor_3"), input_name="ground", **changes):
    rng = np.random.default_rng(7)
    A, B, C, D = _frame()
    u = rng.standard_normal((N_SAMPLES, 1)) * np.exp(-(((np.arange(N_SAMPLES) * DT - 9.0) / 6.0) ** 2))[:, None]
    simulated, h = _simulate(A, B, C, D, u), _pulse(A, B, C, D, 200)
    measured = simulated + 0.03 * simulated.std(axis=0) * rng.standard_normal(simulated.shape)
    record = Record(
        u,
        measured,
        DT,
        input_names=[input_name],
        output_names=list(names),
        input_units=["m/s^2"],
        output_units=["m/s^2"] * 3,
        name="shake table",
    )
    free_run = replace(record, outputs=simulated)
    fits = 1 - np.linalg.norm(measured - simulated, axis=0) / np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    values = np.concatenate([np.repeat([1.0, 0.62, 0.31], 2), 0.012 * 0.93 ** np.arange(60)])
    result = Identification(
        records=(record,),
        excitation=Excitation(
            needed_order=80,
            persistency_order=80,
            condition=41.0,
            excited_share=np.array([0.98]),
            excited_bands=(((0.1, 49.0),),),
            messages=(),
        ),
        observer=ObserverFit(
            feedthrough=D,
            input_coefficients=np.zeros((40, 3, 1)),
            output_coefficients=np.zeros((40, 3, 3)),
            offset=np.zeros(3),
            dt=DT,
            ridge=1e-3,
            input_scale=u.std(axis=0),
            output_scale=measured.std(axis=0),
            residual_covariance=np.diag((0.03 * simulated.std(axis=0)) ** 2),
            n_rows=N_SAMPLES - 40,
            n_parameters=162,
            condition=870.0,
            method="cholesky",
            rank=162,
        ),
        residuals=ResidualCheck(
            autocorrelation=np.vstack([np.ones((1, 3)), 0.02 * rng.standard_normal((40, 3))]),
            whiteness_ratio=1.08,
            whiteness_p_value=0.07,
            input_correlation_ratio=0.97,
            confidence_limit=1.96 / np.sqrt(N_SAMPLES),
            messages=("The residuals are white: the statistic is 1.08 times its degrees of freedom.",),
        ),
        markov=MarkovParameters(system=h, dt=DT, observer_order=40),
        realisation=Realisation(A, B, C, D, DT, K=np.zeros((6, 3)), singular_values=values),
        modes=_modes(),
        order_evidence=OrderEvidence(
            singular_values=values,
            order=6,
            gap_order=6,
            candidate_orders=np.arange(2, 32, 2, dtype=float),
            candidate_fits=np.array([0.55, 0.79, 0.968, 0.967, 0.966, 0.964, 0.965, 0.96, 0.95, np.nan, *[0.94] * 5]),
            stabilisation=_stabilisation(rng),
        ),
        choices=(
            Choice(what="frequency band", value="0 to 50 Hz", reason="The outputs follow the input up to 50 Hz."),
            Choice(
                what="observer order", value="40", reason="Best free run on held-out rows: 0.97 against 0.96 at 20."
            ),
            Choice(what="ridge", value="0.001", reason="Chosen together with the observer order."),
            Choice(what="model order", value="6", reason="Smallest order within 2 % of the best."),
        ),
        fit=Fit(cross_validated=fits, folds=np.array([0.971, 0.968, 0.966]), whole=fits, one_step=fits + 0.01),
        simulated=(free_run,),
        predicted=(free_run,),
        warnings=(),
    )
    return replace(result, **changes)


def _frame():
    """Discrete modal form of the three modes; the feedthrough is that of an absolute acceleration."""
    A = np.zeros((6, 6))
    B = np.zeros((6, 1))
    C = np.zeros((3, 6))
    for mode, (frequency, damping) in enumerate(zip(FREQUENCIES, DAMPINGS, strict=True)):
        omega = 2 * np.pi * frequency
        radius = np.exp(-damping * omega * DT)
        angle = omega * np.sqrt(1 - damping**2) * DT
        block = slice(2 * mode, 2 * mode + 2)
        A[block, block] = radius * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        B[block, 0] = (0.3, 0.1 * (mode + 1))
        C[:, 2 * mode] = SHAPES[:, mode] / (mode + 1)
    return A, B, C, np.full((3, 1), 0.05)


def _simulate(A, B, C, D, u):
    state = np.zeros(A.shape[0])
    rows = []
    for inputs in u:
        rows.append(C @ state + D @ inputs)
        state = A @ state + B @ inputs
    return np.array(rows)


def _pulse(A, B, C, D, n_lags):
    h = [D]
    state = B
    for _ in range(n_lags):
        h.append(C @ state)
        state = A @ state
    return np.array(h)


def _modes():
    modes = []
    for frequency, damping, shape in zip(FREQUENCIES, DAMPINGS, SHAPES.T, strict=True):
        omega = 2 * np.pi * frequency
        modes.append(
            Mode(
                pole=complex(-damping * omega, omega * np.sqrt(1 - damping**2)),
                kind="oscillatory",
                frequency=frequency,
                damping_ratio=damping,
                shape=shape * np.exp(0.03j * np.arange(3)),
                participation=np.array([0.3 - 0.1j]),
                amplitude_coherence=0.998,
                phase_collinearity=0.997,
                emac_output=0.98,
                emac_input=0.97,
                emac=0.95,
                cmi=0.947,
                msv=1.0 / (1 + len(modes)),
                mpd=1.4,
                repeatability=0.96,
                probability=0.988,
                verdict="system",
                reason="found again in both halves (0.97), with another observer (0.95) and at other orders (0.96)",
            )
        )
    modes.append(_bad_mode(23.4, 0.06, "doubtful", "oscillatory", "the two halves of the data disagree about it"))
    modes.append(_bad_mode(31.0, 0.002, "noise", "oscillatory", "not found again"))
    modes.append(_bad_mode(44.0, -0.01, "noise", "unstable", "grows in time"))
    modes.append(_bad_mode(50.0, 0.1, "noise", "nyquist", "at half the sampling frequency: no mode of the system"))
    return ModalModel(modes=tuple(modes), dt=DT, indicator_caution=6 / (40 * 3))


def _bad_mode(frequency, damping, verdict, kind, reason):
    omega = 2 * np.pi * frequency
    repeatability = 0.55 if verdict == "doubtful" else 0.12
    return Mode(
        pole=complex(-damping * omega, omega * np.sqrt(1 - damping**2)),
        kind=kind,
        frequency=frequency,
        damping_ratio=damping,
        shape=np.array([0.2 + 0.9j, -0.7 + 0.1j, 1.0]),
        participation=np.array([0.01 + 0.02j]),
        amplitude_coherence=0.81,
        phase_collinearity=0.4,
        emac_output=0.2,
        emac_input=0.3,
        emac=0.06,
        cmi=0.024,
        msv=0.03,
        mpd=34.0,
        repeatability=repeatability,
        probability=0.1,
        verdict=verdict,
        damping_resolved=False,
        reason=reason,
    )


def _stabilisation(rng):
    points = []
    for order in range(2, 42, 2):
        for index, (frequency, damping) in enumerate(zip(FREQUENCIES, DAMPINGS, strict=True)):
            if order > 2 * index:
                drift = 1 + 0.02 * rng.standard_normal() / order
                overlap = 0.0 if order == 2 * index + 2 else min(1.0, 0.9 + 0.01 * order)
                points.append(_point(order, frequency * drift, damping, overlap, 0.95))
        points += [
            _point(order, rng.uniform(0, 50), 0.03, rng.beta(1, 3), rng.uniform(0, 0.4))
            for _ in range(max(0, order - 6) // 2)
        ]
    return tuple(points)


def _point(order, frequency, damping, overlap, emac):
    return StabilisationPoint(
        order=order, frequency=float(frequency), damping_ratio=damping, overlap=float(overlap), emac=float(emac)
    )
