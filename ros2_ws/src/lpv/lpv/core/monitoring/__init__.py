"""Observer and diagnosis behind one interface, and what they publish."""
