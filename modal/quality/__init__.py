"""Before anything is fitted: what is wrong with the records, where, how badly, and what to do about it."""

from modal.preparation.channel import Finding
from modal.quality.check import check_quality
from modal.quality.findings import ChannelQuality, ChannelStatistics, DataQuality

__all__ = ["ChannelQuality", "ChannelStatistics", "DataQuality", "Finding", "check_quality"]
