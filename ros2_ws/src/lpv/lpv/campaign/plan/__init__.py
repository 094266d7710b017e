"""What a campaign runs: factors, samples, files."""
