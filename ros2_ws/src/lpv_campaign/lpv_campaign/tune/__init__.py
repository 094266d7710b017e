"""Search for the weights of a design by campaigns of runs."""
