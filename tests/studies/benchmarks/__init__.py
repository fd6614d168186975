"""What simulations, fits, the lake, the bench and campaigns cost on a machine; and what all studies share (`base`).

`made_up_*` are campaigns, batches and lakes whose physics costs nothing, so that all else can be measured.
"""
