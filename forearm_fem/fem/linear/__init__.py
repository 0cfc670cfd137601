"""Direct solvers behind one interface, and the order of elimination."""
