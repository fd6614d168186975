"""The two-fidelity Gaussian process: its data, hyperparameters, fit, posterior, and whether it can be trusted."""
