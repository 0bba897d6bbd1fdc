"""Problems drawn at random: a system that nobody tuned to, a coloured input, an unknown initial state, white noise.

    from random_problems import random_problem
    problem = random_problem(5000)
    outputs = problem.noisy(realisation=0)

Two to eight modes between 0.03 and 0.4 of the sampling frequency, the first two close together, the last one weak; one
to three inputs, one to six outputs; C B != 0 and D != 0. The noise is white, of a known standard deviation on each
output (`noise_std`), so that a Cramer-Rao bound exists (`crb`). The last quarter of the rows is held out: one record,
one free run. Nothing here imports okid, era or modal.
"""

from dataclasses import dataclass

import numpy as np
from signals import random_inputs
from systems import TruthSystem, initial_state, random_system, simulate

TRAINING_SHARE = 0.75


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RandomProblem:
    """One system with one input; `noisy` gives as many noise realisations of it as are wanted.

    `inputs` (n_samples, n_inputs) and `clean` (n_samples, n_outputs) hold the training rows, the first `n_training`,
    and the held-out rows after them.
    """

    seed: int
    system: TruthSystem
    inputs: np.ndarray
    clean: np.ndarray
    initial_state: np.ndarray
    noise_share: float
    noise_std: np.ndarray
    n_training: int

    def noisy(self, realisation: int) -> np.ndarray:
        """(n_samples, n_outputs): the clean outputs and the noise with this number, the same at each call."""
        # one more than the number: numpy takes [seed, 0] for the seed itself, whose stream made the inputs
        rng = np.random.default_rng([self.seed, 1 + realisation])
        return self.clean + self.noise_std * rng.standard_normal(self.clean.shape)


def random_problem(seed: int) -> RandomProblem:
    """The problem with this seed: 3000 to 6000 training rows, 1 to 10 % noise."""
    rng = np.random.default_rng(seed)
    n_modes, n_inputs, n_outputs = (int(rng.integers(low, high + 1)) for low, high in ((2, 8), (1, 3), (1, 6)))
    system = random_system(
        rng,
        n_modes=n_modes,
        n_inputs=n_inputs,
        n_outputs=n_outputs,
        close_pair=rng.uniform(0.02, 0.08),
        weak_mode=np.exp(rng.uniform(np.log(0.1), np.log(0.5))),
        damping_range=(0.005, 0.03),
        feedthrough=rng.uniform(0.2, 1.0),
    )
    n_training = int(rng.integers(3000, 6001))
    n_samples = round(n_training / TRAINING_SHARE)
    inputs = random_inputs(rng, n_samples, n_inputs, kind="coloured")
    start = initial_state(rng, system, inputs)
    clean = simulate(system, inputs, initial_state=start)
    share = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
    return RandomProblem(
        seed=seed,
        system=system,
        inputs=inputs,
        clean=clean,
        initial_state=start,
        noise_share=share,
        noise_std=share * clean.std(axis=0),
        n_training=n_training,
    )
