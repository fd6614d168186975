"""Gap discovery on the lake's data.

`split` freezes what is held out, `data` reads the grasps, `bank` plans and reads the simulations, `calibrate` makes
simulators with effects, `rounds` runs rounds and the evaluation, `findings` keeps the answer.
"""
