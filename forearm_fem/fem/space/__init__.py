"""Elements, orders and the numbering of unknowns."""
