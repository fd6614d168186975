"""What naming and adding an effect changes, on designs and objects that were never looked at.

`evaluate`: before, after, floor and peers, and the gap closed. `held_out`: the grasps and their metrics. `baselines`:
the peers. `next_experiment`: what would separate a set, and confounds. `power`: what the data could have shown.
"""
