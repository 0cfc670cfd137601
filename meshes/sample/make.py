"""A sample arm as closed surfaces, the way a scan or segmentation gives them: python3 meshes/sample/make.py

Writes skin.stl, fat.stl, muscle.stl and bone.stl (binary, millimetres) beside itself. Axes: x runs along the arm to the
elbow, y across it to the ulna's side, z out of the volar skin. The device's middle is over x = y = 0; z is free, as
ports are dropped on the skin from above. The sections are flattened ellipses that widen to the elbow; the tissue of a
surface fills what lies between it and the next smaller one. bone.stl holds two bodies, radius and ulna.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

LENGTH = 160.0  # mm
WIDTH, HEIGHT, TAPER = 40.0, 32.0, 0.15  # half axes of the skin under the device, and their growth over half the length
DEPTHS = {"skin": 0.0, "fat": 2.0, "muscle": 6.0}  # mm below the skin
BONES = ((-14.0, -8.0, 7.0), (14.0, -10.0, 7.0))  # y, z, radius


def tube(half_width, half_height, centre, *, taper: float, sections: int, around: int) -> trimesh.Trimesh:
    """A closed elliptic tube [mm] along x, its ends cut straight."""
    x = np.linspace(-LENGTH / 2, LENGTH / 2, sections)[:, None]
    angle = np.arange(around)[None] * 2 * np.pi / around
    wide = taper * 2 * x / LENGTH * np.array([WIDTH, HEIGHT])[:, None, None]
    y = centre[0] + (half_width + wide[0]) * np.cos(angle)
    z = centre[1] + (half_height + wide[1]) * np.sin(angle)
    points = np.stack([np.broadcast_to(x, y.shape), y, z], axis=-1).reshape(-1, 3)
    here = np.arange(sections * around).reshape(sections, around)
    a, b, c, d = here[:-1], here[1:], np.roll(here, -1, 1)[1:], np.roll(here, -1, 1)[:-1]
    wall = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    middles = np.array([[-LENGTH / 2, *centre], [LENGTH / 2, *centre]])
    low, high = len(points), len(points) + 1
    near, far = np.stack([here[0], np.roll(here[0], -1)], 1), np.stack([here[-1], np.roll(here[-1], -1)], 1)
    caps = np.vstack(
        [np.column_stack([np.full(around, low), near]), np.column_stack([np.full(around, high), far[:, ::-1]])]
    )
    body = trimesh.Trimesh(np.vstack([points, middles]), np.vstack([wall, caps]), process=False)
    trimesh.repair.fix_normals(body)
    return body


def sample() -> dict[str, trimesh.Trimesh]:
    """The surfaces by tissue."""
    found = {
        name: tube(WIDTH - deep, HEIGHT - deep, (0.0, 0.0), taper=TAPER, sections=17, around=40)
        for name, deep in DEPTHS.items()
    }
    bones = [tube(r, r, (y, z), taper=0.0, sections=17, around=16) for y, z, r in BONES]
    return {**found, "bone": trimesh.util.concatenate(bones)}


if __name__ == "__main__":
    for name, body in sample().items():
        body.export(Path(__file__).parent / f"{name}.stl")
        print(f"{name}.stl: {len(body.faces)} triangles, {body.volume / 1000:.0f} cm^3, closed: {body.is_watertight}")
