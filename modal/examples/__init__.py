"""Runnable examples: the struck mass, from which everything starts, and the tower of `modal-report demo`."""
