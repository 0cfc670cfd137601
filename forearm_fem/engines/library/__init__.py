"""The arm's library: one long run for a patch of skin, after which any arrangement of discs on it is answered in a
second.

``make`` makes it of two ``side``s, ``kept`` as they go, ``arm`` answers, ``store`` keeps; ``skin`` lays the skin flat,
``loads`` spreads forces on it, ``limb`` is what they see, ``between`` interpolates, ``flat_bells`` are loads on the
layered model, ``bands`` splits the band.
"""

from .arm import ArmLibrary
from .make import is_library, load_library, make_library, save_library

__all__ = ["ArmLibrary", "is_library", "load_library", "make_library", "save_library"]
