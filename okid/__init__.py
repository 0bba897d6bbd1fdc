"""Markov parameters from arbitrary input-output data by an observer-based least-squares fit."""

from okid.errors import (
    IdentificationError,
    IdentificationWarning,
    InsufficientDataError,
    InvalidDataError,
    NumericalError,
    UnreadableFileError,
)
from okid.excitation import Excitation, check_excitation
from okid.frequency_response import FrequencyResponse, estimate_response, pulse_response
from okid.markov import MarkovParameters, recover_markov
from okid.observer import ObserverFit, fit_observer
from okid.readers import read_record, read_records
from okid.readers.response import read_response
from okid.readers.uff import write_response
from okid.record import InputHold, Record
from okid.residuals import ResidualCheck, check_residuals
from okid.rows import join_setups

__version__ = "0.1.0"

__all__ = [
    "Excitation",
    "FrequencyResponse",
    "IdentificationError",
    "IdentificationWarning",
    "InputHold",
    "InsufficientDataError",
    "InvalidDataError",
    "MarkovParameters",
    "NumericalError",
    "ObserverFit",
    "Record",
    "ResidualCheck",
    "UnreadableFileError",
    "check_excitation",
    "check_residuals",
    "estimate_response",
    "fit_observer",
    "join_setups",
    "pulse_response",
    "read_record",
    "read_records",
    "read_response",
    "recover_markov",
    "write_response",
]
