"""What the gains of a run guarantee, examined again."""
