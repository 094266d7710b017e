"""Design of observer and controller gains by linear matrix inequalities."""
