"""Archives of bags: replay, statistics, report."""
