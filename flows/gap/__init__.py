"""Search for what the simulator lacks, on demand and after a recalibration."""
