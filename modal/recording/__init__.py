"""Rerun recordings of results: what was measured, what was found, and how far to trust it, to look at.

Rerun lives behind this package alone, and is imported only when a recording is made.
"""

from modal.recording.stream import log_diagnosis, log_identification, save_recording

__all__ = ["log_diagnosis", "log_identification", "save_recording"]
