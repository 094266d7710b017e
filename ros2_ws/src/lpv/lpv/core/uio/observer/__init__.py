"""Unknown-input observers: the paper's and the exact one, as sampled recursions."""
