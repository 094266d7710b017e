"""Launch files, arm files, scenarios and parameters."""
