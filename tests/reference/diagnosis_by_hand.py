"""A diagnosis filled in by hand: data by the Runge-Kutta rule, every run of every step too; no workflow is asked.

Two masses in a chain, displacements measured. In the upper element there are a cubic spring and dry friction that the
model does not have. The types are the product's, for they are what is to be shown; every number in them is made here.
"""

import functools
from dataclasses import replace

import numpy as np
from nonlinear_chain import no_force, run_chain

from modal.discrepancy.noise.floor import NoiseFloor
from modal.discrepancy.results import (
    Calibrated,
    DetectionLimit,
    Diagnosis,
    Evidence,
    Finding,
    Hypothesis,
    LawCurve,
    Parameter,
    Step,
)
from modal.structure.structural_model import StructuralModel
from okid.record import Record

DT = 0.02
N_SAMPLES = 1000
MASSES, STIFFNESSES, DAMPINGS = (1.0, 1.0), (400.0, 400.0), (0.8, 0.8)
CUBIC, FRICTION = 2e5, 0.06
NOISE = 2e-4
LEVELS = (0.5, 1.5, 0.8, 1.8)
"""Two records to fit, two held out [N rms]."""
N_FIT = 2


def cubic(d, v, t):
    return CUBIC * d**3


def both(d, v, t):
    return CUBIC * d**3 + FRICTION * np.sign(v)


def forces(seed):
    """(4, N_SAMPLES) random multisines between 0.5 and 8 Hz."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(N_SAMPLES, DT)
    lines = np.where((frequency > 0.5) & (frequency < 8.0), 1.0, 0.0)
    spectrum = lines * np.exp(2j * np.pi * rng.random((len(LEVELS), frequency.size)))
    signals = np.fft.irfft(spectrum, N_SAMPLES, axis=1)
    return signals / signals.std(axis=1, keepdims=True) * np.array(LEVELS)[:, np.newaxis]


@functools.cache
def run(seed, stiffnesses, law):
    return _frozen(run_chain(MASSES, stiffnesses, DAMPINGS, forces(seed), DT, law=law, element=1, n_steps=4))


def make_diagnosis(
    *,
    status="named",
    names=("lower", "upper"),
    input_name="force",
    where="element_1",
    units=("m", "m"),
    n_effects=2,
    seed=5,
    **changes,
):
    """A diagnosis of that status; `n_effects` (0, 1 or 2) of the two effects are found, `changes` are fields of it."""
    inputs = forces(seed)
    rng = np.random.default_rng(seed + 1)
    truth = {0: no_force, 1: cubic, 2: both}[2 if status == "unresolved" else n_effects]
    measured = run(seed, STIFFNESSES, truth)
    measured = measured + NOISE * rng.standard_normal(measured.shape)
    records = tuple(
        Record(
            force,
            output,
            DT,
            input_names=[input_name],
            output_names=list(names),
            input_units=["N"],
            output_units=list(units),
            name=f"{'fit' if i < N_FIT else 'held out'}, {level:g} N",
        )
        for i, (force, output, level) in enumerate(zip(inputs, measured, LEVELS, strict=True))
    )
    tried = [("as given", (400.0, 372.0), no_force), ("calibrated", (400.0, 400.0 + 25.0 * (n_effects > 0)), no_force)]
    tried += [(f"cubic_stiffness at {where}", STIFFNESSES, cubic)] * (n_effects > 0)
    tried += [(f"coulomb_friction at {where}", STIFFNESSES, both)] * (n_effects > 1)
    steps = tuple(_step(name, run(seed, k, law), measured) for name, k, law in tried)
    findings = (_cubic(where, status), _friction(where))[:n_effects]
    floor = np.full((len(LEVELS), len(names)), NOISE**2)
    before, after = (_rmse(step, measured) for step in (steps[0], steps[-1]))
    diagnosis = Diagnosis(
        status=status,
        findings=findings,
        model=_model(names, input_name, units),
        noise_floor=NoiseFloor(
            variance=_frozen(floor),
            method=("quiet band",) * len(LEVELS),
            reason=("18 to 25 Hz, 280 samples' worth, sure to 8.5 %.",) * len(LEVELS),
            standard_error=_frozen(np.full_like(floor, 0.085)),
            random=_frozen(np.full_like(floor, np.nan)),
            distortion=_frozen(np.full_like(floor, np.nan)),
        ),
        gap_before=before,
        gap_after=after,
        closed=float(1.0 - (after**2 - NOISE**2).sum() / (before**2 - NOISE**2).sum()),
        calibrated=(
            Calibrated(name="stiffness of element_0", unit="N/m", nominal=400.0, value=400.4, std=0.6, at_bound=False),
            Calibrated(
                name=f"damping of {where}", unit="N s/m", nominal=0.5, value=0.797, std=0.004, at_bound=n_effects > 0
            ),
        ),
        bounds_hit=(f"damping of {where}",) if n_effects else (),
        detection_limits=()
        if n_effects
        else (
            DetectionLimit(effect="cubic_stiffness", where=where, parameter="k3", value=3.1e3, unit="N/m^3"),
            DetectionLimit(effect="coulomb_friction", where=where, parameter="Fc", value=4e-3, unit="N"),
        ),
        advice=("Add a record at twice the level of the loudest one.",),
        location=None,
        steps=steps,
        hypotheses=_hypotheses(steps, where) if n_effects else (),
        laws=_laws(where, measured, rng)[:n_effects],
        fit=records[:N_FIT],
        held_out=records[N_FIT:],
        warnings=(),
    )
    return replace(diagnosis, **changes)


def hysteresis_law(where="element_1"):
    """A law with memory: a parallelogram loop."""
    phase = np.linspace(0, 4 * np.pi, 400)
    motion = 0.02 * np.sin(phase) * np.linspace(0.4, 1.0, 400)
    z = np.empty_like(motion)
    z[0] = 0.0
    for k in range(1, motion.size):
        z[k] = np.clip(z[k - 1] + motion[k] - motion[k - 1], -0.006, 0.006)
    grid = np.linspace(motion.min(), motion.max(), 50)
    nothing = np.zeros(0)
    return LawCurve(
        effect="bouc_wen_hysteresis",
        where=where,
        against="displacement",
        motion=grid,
        force=100 * np.clip(grid, -0.006, 0.006),
        deviation=np.full(50, 0.02),
        points_motion=nothing,
        points_force=nothing,
        points_deviation=nothing,
        loop_motion=motion,
        loop_force=100 * z,
        motion_unit="m",
        force_unit="N",
    )


def _frozen(values):
    values = np.array(values, dtype=float)
    values.flags.writeable = False
    return values


def _step(name, simulated, measured):
    level = ((simulated - measured) ** 2).mean(axis=(1, 2)) / NOISE**2
    return Step(
        name=name,
        fit_level=float(level[:N_FIT].mean()),
        held_out_level=float(level[N_FIT:].mean()),
        simulated=tuple(_frozen(values) for values in simulated[N_FIT:]),
    )


def _rmse(step, measured):
    return _frozen(np.sqrt(((np.array(step.simulated) - measured[N_FIT:]) ** 2).mean(axis=1)))


def _model(names, input_name, units):
    return StructuralModel.chain(
        MASSES,
        STIFFNESSES,
        DAMPINGS,
        force_dofs=[0],
        sensor_dofs=range(len(names)),
        input_names=[input_name],
        output_names=list(names),
        output_units=list(units),
    )


def _cubic(where, status):
    return Finding(
        effect="cubic_stiffness",
        where=where,
        parameters=(Parameter(name="k3", value=2.013e5, std=0.019e5, unit="N/m^3", meaning="cubic stiffness"),),
        law="f = k3 d^3",
        signature="odd lines, third harmonic; the resonance moves with the level",
        evidence=Evidence(
            closed=0.981,
            log_likelihood=41250.0,
            margin=18.0 if status == "unresolved" else 812.0,
            words="It takes away 98.1 % of what was left above the floor and gains 2 ln L = 41250.",
        ),
        runner_up=Hypothesis(
            effects=(("gap_spring", where),), fit_level=14.0, held_out_level=16.2, log_likelihood=40438.0
        ),
        ambiguous_with=("sine_softening",),
    )


def _friction(where):
    return Finding(
        effect="coulomb_friction",
        where=where,
        parameters=(Parameter(name="Fc", value=0.0596, std=0.0006, unit="N", meaning="friction force"),),
        law="f = Fc sign(v)",
        signature="odd lines; damping falls with the level",
        evidence=Evidence(
            closed=0.93, log_likelihood=9120.0, margin=float("inf"), words="It takes away 93 % of what was left."
        ),
        runner_up=None,
        ambiguous_with=(),
    )


def _hypotheses(steps, where):
    """The one found, then what was tried besides, ever worse; the linear model is the last."""
    found = tuple(tuple(step.name.split(" at ", 1)) for step in steps[2:])
    tried = [found, (("gap_spring", where),), (("quadratic_drag", where),), ()]
    worst, best = steps[1].held_out_level, steps[-1].held_out_level
    levels = [best, best + 0.2 * (worst - best), best + 0.8 * (worst - best), worst]
    return tuple(
        Hypothesis(effects=effects, fit_level=0.9 * level, held_out_level=level, log_likelihood=300.0 * (worst - level))
        for effects, level in zip(tried, levels, strict=True)
    )


def _laws(where, measured, rng):
    d = measured[:, :, 1] - measured[:, :, 0]
    v = np.gradient(d, DT, axis=1)
    return (
        _law("cubic_stiffness", where, "displacement", d, law=lambda x: CUBIC * x**3, unit="m", rng=rng),
        _law("coulomb_friction", where, "velocity", v, law=lambda x: FRICTION * np.sign(x), unit="m/s", rng=rng),
    )


def _law(effect, where, against, motion, *, law, unit, rng):
    reach = float(np.abs(motion).max())
    grid, centres = np.linspace(-reach, reach, 201), np.linspace(-0.9 * reach, 0.9 * reach, 15)
    size = float(np.abs(law(grid)).max())
    spread = np.full(15, 0.03 * size)
    return LawCurve(
        effect=effect,
        where=where,
        against=against,
        motion=_frozen(grid),
        force=_frozen(law(grid)),
        deviation=_frozen(0.01 * np.abs(law(grid)) + 0.004 * size),
        points_motion=_frozen(centres),
        points_force=_frozen(law(centres) + spread * rng.standard_normal(15)),
        points_deviation=_frozen(spread),
        loop_motion=_frozen([]),
        loop_force=_frozen([]),
        motion_unit=unit,
        force_unit="N",
    )
