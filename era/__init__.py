"""From Markov parameters to a state-space realisation, its simulation and its Kalman gain."""

from era.balanced import decompose, realise, realise_data_correlation, realise_from
from era.gain import GainEstimate, estimate_gain, gain_from_innovations
from era.kalman import Forecast, check_innovations, forecast, innovations, kalman_filter
from era.realisation import HankelFactors, Realisation
from era.simulation import estimate_initial_state, predict, simulate

__all__ = [
    "Forecast",
    "GainEstimate",
    "HankelFactors",
    "Realisation",
    "check_innovations",
    "decompose",
    "estimate_gain",
    "estimate_initial_state",
    "forecast",
    "gain_from_innovations",
    "innovations",
    "kalman_filter",
    "predict",
    "realise",
    "realise_data_correlation",
    "realise_from",
    "simulate",
]
