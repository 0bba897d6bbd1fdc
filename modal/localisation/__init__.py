"""Where and how a simulation and the measurement disagree, for the reader, before anything is fitted."""
