"""Messages of a bag in blocks of some megabytes, thousands at once."""
