"""Running a campaign and storing its results."""
