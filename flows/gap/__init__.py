"""Search for what the simulator lacks.

`search` runs on demand, `scheduled` after a recalibration; `folder` writes the page.
"""
