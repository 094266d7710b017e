"""``lpv replay``, and the arguments that it shares with other commands."""
