"""The running graph, as a command sees it."""
