"""Replaying bags: offline through the diagnosis, or into a live graph."""
