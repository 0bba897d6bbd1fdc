"""An identification made by hand: known modes, a plain simulation loop, made-up evidence; no code under test."""

import importlib.util
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from era.realisation import Realisation
from modal.identification.result import Identification, OrderEvidence
from modal.modes.mode import Choice, Fit, ModalModel, Mode
from modal.verdict.stabilisation import StabilisationPoint
from okid.excitation import Excitation
from okid.markov import MarkovParameters
from okid.observer import ObserverFit
from okid.record import Record
from okid.residuals import ResidualCheck


def true_model(n_modes, n_inputs, n_outputs, dt, rng):
    """Modal blocks of equally spaced frequencies; shapes are sines over the outputs."""
    A = np.zeros((2 * n_modes, 2 * n_modes))
    C = np.zeros((n_outputs, 2 * n_modes))
    poles, shapes = [], []
    place = (np.arange(n_outputs) + 1.0) / (n_outputs + 0.5)
    for r in range(n_modes):
        omega = 2 * np.pi * 0.4 / dt * (r + 0.5) / n_modes
        zeta = 0.01 + 0.004 * r
        s = complex(-zeta * omega, omega * np.sqrt(1 - zeta**2))
        lam = np.exp(s * dt)
        A[2 * r : 2 * r + 2, 2 * r : 2 * r + 2] = [[lam.real, lam.imag], [-lam.imag, lam.real]]
        shape = np.sin((r + 0.5) * np.pi * place)
        C[:, 2 * r] = shape
        poles.append(s)
        shapes.append(shape / shape[np.abs(shape).argmax()])
    B = rng.standard_normal((2 * n_modes, n_inputs))
    D = 0.05 * rng.standard_normal((n_outputs, n_inputs))
    return A, B, C, D, poles, shapes


def simulate(A, B, C, D, u):
    x = np.zeros(A.shape[0])
    y = np.empty((u.shape[0], C.shape[0]))
    for k in range(u.shape[0]):
        y[k] = C @ x + D @ u[k]
        x = A @ x + B @ u[k]
    return y


def make_mode(pole, shape, n_inputs, verdict, rng):
    system = verdict == "system"
    high = lambda a, b: float(rng.uniform(a, b))  # noqa: E731 - a short name for a table of made-up numbers
    frequency = abs(pole) / 2 / np.pi
    emac = high(0.85, 0.99) if system else high(0.0, 0.3)
    mpc = high(0.97, 1.0) if system else high(0.1, 0.8)
    reason = {
        "system": f"repeats in every fold (overlap {high(0.97, 1):.2f}) and both EMACs are above 0.5.",
        "doubtful": "repeats in 3 of 5 folds only, so its damping is not to be trusted.",
        "noise": "found in one fold only; its response dies out within the noise.",
    }[verdict]
    return Mode(
        pole=pole,
        kind="oscillatory",
        frequency=frequency,
        damping_ratio=-pole.real / abs(pole),
        shape=np.asarray(shape, dtype=complex),
        participation=rng.standard_normal(n_inputs) + 0j,
        frequency_std=frequency * 1e-3,
        damping_ratio_std=4e-4,
        amplitude_coherence=high(0.98, 1.0) if system else high(0.4, 0.9),
        phase_collinearity=mpc,
        emac_output=emac**0.5,
        emac_input=emac**0.5,
        emac=emac,
        cmi=emac * mpc,
        msv=high(0.2, 1.0) if system else high(0, 0.1),
        mpd=high(0, 4) if system else high(15, 60),
        repeatability=high(0.95, 1.0) if system else high(0, 0.4),
        probability=high(0.97, 1.0) if system else high(0, 0.2),
        verdict=verdict,
        damping_resolved=verdict == "system",
        reason=reason,
    )


def build_identification(
    *,
    n_modes=3,
    n_noise=4,
    n_inputs=2,
    n_outputs=4,
    n_samples=3000,
    n_records=1,
    dt=0.01,
    noise=0.05,
    missing=False,
    output_names=None,
    input_names=None,
    units="m/s^2",
    seed=1,
    system=True,
):
    rng = np.random.default_rng(seed)
    A, B, C, D, poles, shapes = true_model(max(n_modes, 1), n_inputs, n_outputs, dt, rng)
    records, simulated, predicted = [], [], []
    for r in range(n_records):
        u = rng.standard_normal((n_samples, n_inputs))
        clean = (
            simulate(A, B, C, D, u)
            if n_samples <= 20_000
            else np.cumsum(rng.standard_normal((n_samples, n_outputs)), axis=0)
        )
        y = clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)
        if missing:
            y[n_samples // 3 : n_samples // 2, 0] = np.nan
            y[n_samples // 5, -1] = np.nan
        names = {
            "output_names": output_names or [f"floor_{i + 1}" for i in range(n_outputs)],
            "input_names": input_names or [f"shaker_{i + 1}" for i in range(n_inputs)],
            "output_units": [units] * n_outputs if isinstance(units, str) else units,
            "input_units": ["N"] * n_inputs,
            "name": f"run {r + 1}",
        }
        records.append(Record(u, y, dt, **names))
        simulated.append(Record(u, clean, dt, **names))
        predicted.append(Record(u, 0.7 * clean + 0.3 * np.where(np.isnan(y), clean, y), dt, **names))
    order = A.shape[0]
    n_lags = 120
    h = np.empty((n_lags + 1, n_outputs, n_inputs))
    h[0] = D
    X = B
    for k in range(1, n_lags + 1):
        h[k] = C @ X
        X = A @ X
    verdict = "system" if system else "doubtful"
    modes = [make_mode(p, s, n_inputs, verdict, rng) for p, s in zip(poles, shapes, strict=True)] if n_modes else []
    for f in rng.uniform(0.02, 0.48, n_noise) / dt:
        pole = complex(-2 * np.pi * f * rng.uniform(0.01, 0.2), 2 * np.pi * f)
        shape = rng.standard_normal(n_outputs) + 1j * rng.standard_normal(n_outputs)
        modes.append(make_mode(pole, shape / shape[np.abs(shape).argmax()], n_inputs, "noise", rng))
    modes.sort(key=lambda mode: mode.frequency)
    p = 20
    lag = np.arange(26)
    return Identification(
        records=tuple(records),
        excitation=Excitation(
            needed_order=40,
            persistency_order=40,
            condition=12.0,
            excited_share=np.ones(n_inputs),
            excited_bands=(((0.0, 0.5 / dt),),) * n_inputs,
            messages=("The inputs move in every direction that 40 lags ask for.",),
        ),
        observer=ObserverFit(
            feedthrough=D,
            input_coefficients=np.zeros((p, n_outputs, n_inputs)),
            output_coefficients=np.zeros((p, n_outputs, n_outputs)),
            offset=np.zeros(n_outputs),
            dt=dt,
            ridge=0.0,
            input_scale=np.ones(n_inputs),
            output_scale=np.ones(n_outputs),
            residual_covariance=np.eye(n_outputs),
            n_rows=(n_samples - p) * n_records,
            n_parameters=p * (n_inputs + n_outputs) + n_inputs + 1,
            condition=300.0,
            method="cholesky",
            rank=p * (n_inputs + n_outputs) + n_inputs + 1,
        ),
        residuals=ResidualCheck(
            autocorrelation=np.where(
                lag[:, None] == 0, 1.0, 0.02 * np.random.default_rng(seed).standard_normal((26, n_outputs))
            ),
            whiteness_ratio=1.08,
            whiteness_p_value=0.2,
            input_correlation_ratio=0.97,
            confidence_limit=0.036,
            messages=("The residual is white and free of the input.",),
        ),
        markov=MarkovParameters(system=h, dt=dt, gain=np.zeros((n_lags + 1, n_outputs, n_outputs)), observer_order=p),
        realisation=Realisation(A, B, C, D, dt, K=0.01 * C.T, singular_values=np.geomspace(1, 1e-4, 80)),
        modes=ModalModel(modes=tuple(modes), dt=dt, indicator_caution=order / (p * n_outputs)),
        order_evidence=evidence(poles, order, dt, rng),
        choices=(
            Choice(what="observer order", value=str(p), reason="held-out free-run fit 0.95, best of 5, 10, 20, 40."),
            Choice(what="ridge", value="0", reason="no ridge was within 0.001 of the best."),
            Choice(what="model order", value=str(order), reason="gap s6/s7 = 23, and the fit falls by 0.02 at 4."),
            Choice(what="frequency band", value=f"0 to {0.5 / dt:g} Hz", reason="coherence above 0.5 up to there."),
        ),
        fit=Fit(
            cross_validated=rng.uniform(0.9, 0.97, n_outputs),
            folds=rng.uniform(0.9, 0.97, 5),
            whole=rng.uniform(0.95, 0.98, n_outputs),
            one_step=rng.uniform(0.98, 0.995, n_outputs),
        ),
        simulated=tuple(simulated),
        predicted=tuple(predicted),
        warnings=() if system else ("The cross-validated fit is 0.31, below 0.5: no mode is certain.",),
    )


def evidence(poles, order, dt, rng):
    values = np.concatenate([np.repeat(np.geomspace(120, 9, order // 2), 2), np.geomspace(0.4, 0.05, 70)])
    points = []
    for n in range(2, 42, 2):
        for r, s in enumerate(poles):
            if n >= 2 * r + 2:
                new = n < 2 * r + 4
                f = abs(s) / 2 / np.pi * (1 + rng.normal() * (3e-2 if new else 2e-3))
                overlap = 0.3 if new else 1 - abs(rng.normal()) * 0.01
                points.append(StabilisationPoint(order=n, frequency=f, damping_ratio=0.01, overlap=overlap, emac=0.9))
        points += [
            StabilisationPoint(order=n, frequency=f, damping_ratio=0.05, overlap=float(rng.uniform(0, 0.7)), emac=0.1)
            for f in rng.uniform(0, 0.5 / dt, max(0, n // 2 - len(poles)))
        ]
    orders = np.arange(2.0, 32.0, 2.0)
    fits = 0.95 * (1 - np.exp(-orders / order * 2)) - 0.002 * np.maximum(orders - order, 0)
    fits[-2] = np.nan
    return OrderEvidence(
        singular_values=values,
        order=order,
        gap_order=order,
        candidate_orders=orders,
        candidate_fits=fits,
        stabilisation=tuple(points),
    )


@pytest.fixture(scope="session")
def build():
    return build_identification


@pytest.fixture(scope="session")
def identification():
    return build_identification()


@pytest.fixture
def without_modes():
    found = build_identification(n_noise=2)
    noise = tuple(mode for mode in found.modes.modes if mode.verdict == "noise")
    return replace(found, modes=replace(found.modes, modes=noise))


class Stored:
    """A recording read back: entities, series, tables."""

    def __init__(self, path):
        from rerun.chunk import RrdReader

        self.reader = RrdReader(str(path))
        self.store = self.reader.store()

    def entities(self, component):
        return [str(c.entity_path) for c in self.store.schema().component_columns() if c.component == component]

    def timelines(self):
        return [c.name for c in self.store.schema().index_columns()]

    def batches(self, path, *, static):
        chunks = self.store.stream().filter(content=path, is_static=static).to_chunks()
        return [chunk.to_record_batch() for chunk in chunks]

    def static(self, path, component):
        found = [
            b.column(component).to_pylist() for b in self.batches(path, static=True) if component in b.schema.names
        ]
        return found[-1][-1]

    def every(self, path, component):
        """All values of a component, static or of any row."""
        batches = [*self.batches(path, static=True), *self.batches(path, static=False)]
        cells = [cell for b in batches if component in b.schema.names for cell in b.column(component).to_pylist()]
        return [value for cell in cells for value in cell or []]

    def rows(self, path, timeline):
        """{index: {component: list}}"""
        rows = {}
        for batch in self.batches(path, static=False):
            if timeline not in batch.schema.names:
                continue
            columns = {n: batch.column(n).to_pylist() for n in batch.schema.names if n != "rerun.controls.RowId"}
            for k, index in enumerate(columns.pop(timeline)):
                rows.setdefault(index, {}).update({name: values[k] for name, values in columns.items()})
        return dict(sorted(rows.items()))

    def table(self, path, timeline):
        rows = self.rows(path, timeline)
        names = next(iter(rows.values()))
        return {timeline: list(rows)} | {
            name: [row[name][0] if row[name] else np.nan for row in rows.values()] for name in names
        }

    def vectors(self, path, timeline):
        rows = self.rows(path, timeline)
        return list(rows), np.array([row["Scalars:scalars"] for row in rows.values()])

    def series(self, path, which=0):
        """Times, and the values of one of the channels of an entity."""
        times, values = [], []
        for batch in self.batches(path, static=False):
            times.append(
                batch.column("time").to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(float) / 1e9
            )
            cells = batch.column("Scalars:scalars").to_pylist()
            values.append(np.array([cell[which] if cell else np.nan for cell in cells]))
        times, values = np.concatenate(times), np.concatenate(values)
        order = np.argsort(times, kind="stable")
        return times[order], values[order]

    def frames(self, path, component):
        return [row for batch in self.batches(path, static=False) for row in batch.column(component).to_pylist()]


@pytest.fixture(scope="session")
def read():
    return Stored


@pytest.fixture(scope="session")
def exit_of():
    """Exit status of the command `rerun`, which checks and compares recordings, for its arguments."""
    if importlib.util.find_spec("rerun_cli") is None:
        pytest.skip("the command `rerun`, which checks and compares recordings, is not installed beside rerun-sdk")
    # `-m rerun` loads the whole library first, `-m rerun_cli` forgets the status
    command = [sys.executable, "-c", "import sys; from rerun_cli.__main__ import main; sys.exit(main())"]
    return lambda *arguments: subprocess.run([*command, *arguments], capture_output=True, check=False).returncode


@pytest.fixture(scope="session")
def stored(identification, tmp_path_factory):
    """The recording of the plain identification, for whoever only reads it."""
    from modal.recording import save_recording

    return Stored(save_recording(identification, tmp_path_factory.mktemp("recording") / "run.rrd"))


@pytest.fixture(autouse=True)
def strict():
    import rerun as rr

    rr.set_strict_mode(True)
