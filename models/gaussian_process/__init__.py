"""What several Gaussian processes share: Matern covariances and log densities, with their gradients."""
