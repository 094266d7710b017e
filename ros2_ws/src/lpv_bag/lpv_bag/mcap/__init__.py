"""The MCAP format: reading whole and damaged files, writing; knows nothing of arms."""
