"""Many records: each identified exactly once, by any executor, resumable; one table of all modes.

`identify_batch` is the whole of it; `Workers` is an executor whose processes are started again when they die.
"""

from modal.batch.running import Workers, identify_batch
from modal.batch.tables import Batch
from okid.errors import ExecutorError

__all__ = ["Batch", "ExecutorError", "Workers", "identify_batch"]
