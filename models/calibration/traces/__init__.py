"""What inference from force traces begins with: the grid of simulations, response surfaces, errors of features."""
