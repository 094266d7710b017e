"""Live view: a web page of the running arm, the Foxglove protocol, markers."""
