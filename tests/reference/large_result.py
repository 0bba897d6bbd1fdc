"""A made-up result of 60 outputs, 100 modes of the system, 100 other poles and 30 records: nothing but large."""

from dataclasses import replace

import numpy as np

from era.realisation import Realisation
from modal.identification.result import Identification, OrderEvidence
from modal.modes.mode import Fit, ModalModel, Mode
from modal.verdict.stabilisation import StabilisationPoint
from okid.markov import MarkovParameters
from okid.record import Record

N_OUTPUTS, N_INPUTS, N_MODES, N_RECORDS, N_SAMPLES, DT = 60, 4, 100, 30, 1200, 1e-3


def make_large(small: Identification) -> Identification:
    """Sizes as above; everything else as in the small result."""
    rng = np.random.default_rng(1)
    names = [f"wing panel {i // 3 + 1} sensor {'XYZ'[i % 3]} (rear spar, left half)" for i in range(N_OUTPUTS)]
    records = tuple(
        Record(
            rng.standard_normal((N_SAMPLES, N_INPUTS)),
            rng.standard_normal((N_SAMPLES, N_OUTPUTS)),
            DT,
            output_names=names,
            output_units=["m/s^2"] * N_OUTPUTS,
            name=f"sweep {i + 1}",
        )
        for i in range(N_RECORDS)
    )
    order = 2 * N_MODES
    fits = np.linspace(0.9, 0.95, N_OUTPUTS)
    return replace(
        small,
        records=records,
        simulated=records,
        predicted=records,
        excitation=replace(
            small.excitation,
            excited_share=np.ones(N_INPUTS),
            excited_bands=tuple(((float(i), i + 0.5),) * 40 for i in range(N_INPUTS)),
            messages=(),
        ),
        observer=replace(
            small.observer,
            feedthrough=np.zeros((N_OUTPUTS, N_INPUTS)),
            input_coefficients=np.zeros((10, N_OUTPUTS, N_INPUTS)),
            output_coefficients=np.zeros((10, N_OUTPUTS, N_OUTPUTS)),
            offset=np.zeros(N_OUTPUTS),
            input_scale=np.ones(N_INPUTS),
            output_scale=np.ones(N_OUTPUTS),
            residual_covariance=np.eye(N_OUTPUTS),
        ),
        residuals=replace(small.residuals, autocorrelation=0.02 * rng.standard_normal((200, N_OUTPUTS)), messages=()),
        markov=MarkovParameters(system=0.1 * rng.standard_normal((400, N_OUTPUTS, N_INPUTS)), dt=DT),
        realisation=Realisation(
            0.5 * np.eye(order),
            rng.standard_normal((order, N_INPUTS)),
            rng.standard_normal((N_OUTPUTS, order)),
            np.zeros((N_OUTPUTS, N_INPUTS)),
            DT,
        ),
        modes=ModalModel(modes=_modes(rng), dt=DT, indicator_caution=0.1),
        order_evidence=OrderEvidence(
            singular_values=np.geomspace(1.0, 1e-6, 2000),
            order=order,
            gap_order=4,
            candidate_orders=np.arange(2.0, 402.0, 2.0),
            candidate_fits=np.full(200, 0.9),
            stabilisation=_poles(rng),
        ),
        fit=Fit(cross_validated=fits, folds=np.array([0.9, 0.91, 0.92]), whole=fits, one_step=fits),
    )


def _modes(rng: np.random.Generator) -> tuple[Mode, ...]:
    modes = []
    for i in range(2 * N_MODES):
        frequency = 2.0 + 2.4 * i
        omega = 2 * np.pi * frequency
        believed = i % 2 == 0
        modes.append(
            Mode(
                pole=complex(-0.01 * omega, omega),
                kind="oscillatory",
                frequency=frequency,
                damping_ratio=0.01,
                frequency_std=0.01,
                damping_ratio_std=1e-4,
                shape=rng.standard_normal(N_OUTPUTS) + 0.1j * rng.standard_normal(N_OUTPUTS),
                participation=np.ones(N_INPUTS, dtype=complex),
                amplitude_coherence=0.99,
                repeatability=0.95 if believed else 0.1,
                probability=0.99 if believed else 0.01,
                verdict="system" if believed else "noise",
                reason="found again: halves of the data 1.00, other observer order and ridge 1.00, other orders 1.00",
            )
        )
    return tuple(modes)


def _poles(rng: np.random.Generator) -> tuple[StabilisationPoint, ...]:
    return tuple(
        StabilisationPoint(
            order=order,
            frequency=float(rng.uniform(0, 500)),
            damping_ratio=0.01,
            overlap=float(rng.uniform()),
            emac=float(rng.uniform()),
            repeatability=float(rng.uniform()),
        )
        for order in range(2, 402, 2)
        for _ in range(order // 2)
    )
