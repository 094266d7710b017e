"""One report of a campaign of runs or of bags: a page, its numbers, a summary on the terminal."""
