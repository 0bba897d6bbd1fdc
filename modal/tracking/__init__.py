"""Modes followed through many records: which pole belongs to which mode, what its causes explain, what changed.

`track` is the whole of it; it returns `Tracks`.
"""

from modal.tracking.tracks import Alarm, Track, Tracks, track

__all__ = ["Alarm", "Track", "Tracks", "track"]
