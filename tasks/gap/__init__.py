"""Gap discovery on the lake's data: measurements, bank of simulations, findings."""
