"""Parameters, lifecycle and quality of service shared by the nodes."""
