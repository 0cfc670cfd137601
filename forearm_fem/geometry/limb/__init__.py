"""Parametric limbs and slabs meshed: layers of exact thickness around a core."""
