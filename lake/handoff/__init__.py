"""Hand-off folders: import and export of grasps as CSV and Parquet."""
