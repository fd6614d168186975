"""Hand-off folders: grasps of other labs and simulators come in, and ours go out, as CSV and Parquet.

A reader for another format is a function that returns `HandoffTables`.
"""

from fast.lake.handoff.readers import HandoffTables

__all__ = ["HandoffTables"]
