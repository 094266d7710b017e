"""Statistics of the diagnosis over thousands of closed-loop runs, or over archives of bags."""
