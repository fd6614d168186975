"""What naming and adding an effect changes, on designs and objects that were never looked at.

`evaluate`: before, after and floor, and the gap closed. `held_out`: the grasps and their metrics. `rest`: what is left
after a name, in words and as a curve. `confounds`: what cannot be told from theta.
"""
