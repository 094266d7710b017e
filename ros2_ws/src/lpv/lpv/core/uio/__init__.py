"""The unknown-input observer of the paper and its LPV design, for planar two-link arms."""
