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
from okid.markov import MarkovParameters, recover_markov
from okid.observer import ObserverFit, fit_observer
from okid.readers import read_record, read_records
from okid.record import InputHold, Record
from okid.residuals import ResidualCheck, check_residuals

__version__ = "0.1.0"

__all__ = [
    "Excitation",
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
    "fit_observer",
    "read_record",
    "read_records",
    "recover_markov",
]
