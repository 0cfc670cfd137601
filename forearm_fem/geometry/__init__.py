"""Limbs as tetrahedra: surfaces, layers, regions and bends, ports upon them, and the cache of meshes."""
