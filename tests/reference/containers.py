"""Systems whose truth is known in the containers of the product, which add nothing to them."""

from systems import markov

from era.realisation import Realisation
from okid.markov import MarkovParameters


def realisation_of(system, K=None):
    return Realisation(system.A, system.B, system.C, system.D, system.dt, K=K)


def markov_parameters(system, n_lags=80, **extra):
    return MarkovParameters(system=markov(system, n_lags), dt=system.dt, **extra)
