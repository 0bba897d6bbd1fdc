"""From Markov parameters to a state-space realisation, its simulation and its Kalman gain."""

from era.balanced import decompose, realise, realise_from
from era.initial_state import estimate_initial_state
from era.kalman import innovations, kalman_filter
from era.realisation import HankelFactors, Realisation
from era.simulation import predict, simulate

__all__ = [
    "HankelFactors",
    "Realisation",
    "decompose",
    "estimate_initial_state",
    "innovations",
    "kalman_filter",
    "predict",
    "realise",
    "realise_from",
    "simulate",
]
