"""What every Gaussian process here shares: Matern covariance and the Gaussian density."""
