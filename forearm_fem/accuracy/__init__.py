"""Numerical error of a result: every estimate of it, for whatever engine, and what it does to G.

``discretisation`` compares two meshes and ``dispersion`` says what both may miss; ``truncation`` is of cut ends,
``pair_errors`` shares an error over pairs of ports, ``of_library`` is a library's, ``perturbed`` draws G with its
errors, ``estimates`` makes and judges them.
"""
