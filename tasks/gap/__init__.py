"""Gap discovery: grasps and the bank from the lake, rounds of a search, findings back into it.

`split` freezes what is held out, `data` reads the grasps, `bank` plans and reads the simulations, `calibrate` makes
simulators with effects, `rounds` runs rounds and the evaluation, `findings` keeps the answer.
"""
