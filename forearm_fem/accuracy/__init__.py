"""Numerical error of a result: every estimate of it, for whatever engine, and what it does to G.

``exact`` compares a slab with the layered model, ``discretisation`` two meshes of any other limb, ``truncation`` is of
its cut ends, ``other_tissues`` of moduli that were not solved for. ``estimates`` shares errors over pairs of ports,
draws G with them and judges them.
"""
