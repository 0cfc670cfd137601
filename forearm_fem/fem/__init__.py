"""Finite elements: space, assembly, linear solvers, reduction."""
