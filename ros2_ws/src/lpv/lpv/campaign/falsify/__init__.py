"""Search for healthy runs that come nearest to a threshold: attempts to break the guarantee."""
