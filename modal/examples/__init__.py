"""Runnable examples: the struck mass, the tower of `modal-report demo`, and two stories of a missing effect."""
