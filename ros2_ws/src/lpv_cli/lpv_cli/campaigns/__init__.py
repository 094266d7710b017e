"""Campaigns, archives of bags and tuning: the commands that run thousands of times."""
