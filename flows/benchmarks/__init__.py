"""Benchmarks: what simulations, fits, the lake, the bench and campaigns cost on a machine (`fast bench`).

Each benchmark is a module, `registry` names them, and `base` has what they share. `made_up_*` are campaigns, batches
and lakes whose physics costs nothing, so that all else can be measured. Studies of the project are in `tests/studies`.
"""
