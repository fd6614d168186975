"""Simulated grasps: what is missing, worker processes that solve it, rows that keep it.

`attempt` runs in a worker and says what came of a grasp. `simulate` does a campaign's designs, `plan` the points of a
hypercube. `engine` says where workers are: `pool` on this machine, `engine_dask` on a cluster.
"""
