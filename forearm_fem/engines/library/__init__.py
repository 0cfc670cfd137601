"""The arm's library: one long run for a patch of skin, after which any arrangement of discs on it is answered in a
second.

``make`` makes it of two ``side``s, kept as they go, and ``arm`` answers. ``skin`` lays the skin flat, and ``between``
interpolates.
"""

from .arm import ArmLibrary
from .make import is_library, load_library, make_library, save_library

__all__ = ["ArmLibrary", "is_library", "load_library", "make_library", "save_library"]
