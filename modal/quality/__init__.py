"""Before anything is fitted: what is wrong with the records, where, how badly, and what to do about it."""

from modal.preparation.channel import Finding
from modal.quality.check import ChannelQuality, ChannelStatistics, DataQuality, check_quality

__all__ = ["ChannelQuality", "ChannelStatistics", "DataQuality", "Finding", "check_quality"]
