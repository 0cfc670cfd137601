"""Meshes and surfaces that users bring: defects, each with words of its sentence, and odd but valid ones.

A case writes its files into a folder and gives the limb's table. ``python tests/bad_meshes.py`` prints the sentences.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import trimesh
from bad_files import CORNERS, TETRA

from forearm_fem.geometry.mesh.tissue_mesh import boundary_faces

REST = {
    "mesh": {"size_grid": 8e-3, "size_contact": 4e-3, "size_far": 12e-3, "min_quality": 0.005},
    "device": {"contacts": [[-0.012, 0], [0.012, 0]]},
    "grid": {"points": [[0, 0]]},
}
UPPER = CORNERS[TETRA].mean(axis=1)[:, 2] > -0.01
NUMBERS = np.where(UPPER, 2, 1)
EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


@dataclass(frozen=True)
class Brought:
    """A user's limb: how its files are written, the limb's table, and what its sentence says (nothing: it is valid)."""

    name: str
    write: Callable[[Path], None]
    limb: dict[str, Any]
    says: tuple[str, ...] = ()
    rest: dict[str, Any] = field(default_factory=lambda: REST)

    def scenario(self) -> dict[str, Any]:
        """The scenario as data; a mesh brings its own sizes."""
        sizes = dict(self.rest.get("mesh", {}))
        if self.limb["shape"] == "mesh":
            sizes = {k: v for k, v in sizes.items() if k not in ("size_grid", "size_far")}
        return {**self.rest, "mesh": sizes, "limb": self.limb}


def cells(
    points: Any = CORNERS, tetrahedra: Any = TETRA, region: Any = NUMBERS, name: str = "limb.vtu", **more: Any
) -> Callable[[Path], None]:
    """Writer of one block of tetrahedra with their regions."""

    def write(folder: Path) -> None:
        data = {} if region is None else {"region": [np.asarray(region)]}
        kind = "tetra" if np.shape(tetrahedra)[1] == 4 else "tetra10"
        made = meshio.Mesh(np.asarray(points), [(kind, np.asarray(tetrahedra))], cell_data=data)
        for key, value in more.items():
            setattr(made, key, value)
        made.write(folder / name)

    return write


def of_mesh(name: str, write: Callable[[Path], None], *says: str, **limb: Any) -> Brought:
    table = {"shape": "mesh", "file": "limb.vtu", "regions": {"1": "muscle", "2": "fat"}, **limb}
    return Brought(name, write, table, says)


def quadratic(bend: float = 0.0) -> tuple[Any, Any]:
    """Points and tetra10 cells; the middle of one edge in the first cell is moved by ``bend`` [m]."""
    ends = np.sort(TETRA[:, np.array(EDGES)].reshape(-1, 2), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    middles = CORNERS[edges].mean(axis=1)
    middles[number.ravel()[0]] += [0, 0, bend]
    return np.vstack([CORNERS, middles]), np.hstack([TETRA, len(CORNERS) + number.reshape(-1, 6)])


def changed(array: Any, at: Any, value: Any) -> Any:
    """A copy with one entry replaced."""
    out = np.array(array)
    out[at] = value
    return out


def doubled() -> tuple[Any, Any]:
    """The two regions with vertices of their own, as programs that mesh tissue by tissue leave them."""
    lower = np.unique(TETRA[~UPPER])
    again = np.full(len(CORNERS), -1)
    again[lower] = len(CORNERS) + np.arange(len(lower))
    return np.vstack([CORNERS, CORNERS[lower]]), np.where(UPPER[:, None], TETRA, again[TETRA])


def inside() -> int:
    """Number of a tetrahedron none of whose vertices lies on the boundary, in a block cut more finely."""
    low, high = FINE.min(axis=0), FINE.max(axis=0)
    free = (np.minimum(FINE - low, high - FINE) > 1e-9).all(axis=1)
    return int(np.flatnonzero(free[FINE_TETRA].all(axis=1))[0])


def on_an_edge() -> int:
    """Number of a tetrahedron with an edge, but no face, on the boundary of that block."""
    faces, owner = boundary_faces(FINE_TETRA)
    rim = {tuple(sorted(side)) for face in faces for side in (face[:2], face[1:], face[::2])}
    others = np.setdiff1d(np.arange(len(FINE_TETRA)), owner)
    return next(int(k) for k in others if any(tuple(sorted(FINE_TETRA[k][list(e)])) in rim for e in EDGES))


def finer() -> tuple[Any, Any]:
    """The block with five layers of cubes, each of six tetrahedra."""
    n = (9, 9, 6)
    axes = (np.linspace(-0.04, 0.04, 9), np.linspace(-0.04, 0.04, 9), np.linspace(-0.05, 0, 6))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(np.prod(n)).reshape(n)
    corner = [index[i : 8 + i, j : 8 + j, k : 5 + k].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    paths = ((0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7))
    return grid, np.vstack([np.column_stack([corner[c] for c in path]) for path in paths])


FINE, FINE_TETRA = finer()
ONES = np.ones(len(FINE_TETRA), int)
MUSCLE = {"regions": {"1": "muscle"}}
FLAT = np.vstack([CORNERS, [[-0.039, -0.039, -0.02 - 1e-12]]])
FOLDED = changed(CORNERS, int(np.argmin(np.linalg.norm(CORNERS - [0, 0, -0.01], axis=1))), [0.0, 0.0, 0.03])
APART = np.vstack([CORNERS, CORNERS[TETRA[0]] + [0.2, 0, 0]])
N = len(CORNERS)
NAMED = {"field_data": {"arm": np.array([1, 3]), "wrap": np.array([2, 3])}}
SETS = {"lower": [np.flatnonzero(~UPPER)], "upper": [np.flatnonzero(UPPER)]}


def with_sets(sets: dict[str, Any]) -> Callable[[Path], None]:
    """Abaqus file: regions are element sets."""

    def write(folder: Path) -> None:
        meshio.Mesh(CORNERS, [("tetra", TETRA)], cell_sets=sets).write(folder / "limb.inp")

    return write


def gmsh_named(folder: Path) -> None:
    made = meshio.Mesh(CORNERS, [("tetra", TETRA)], field_data=NAMED["field_data"])
    made.cell_data = {"gmsh:physical": [NUMBERS.astype(np.int32)], "gmsh:geometrical": [NUMBERS.astype(np.int32)]}
    meshio.write(folder / "limb.msh", made, file_format="gmsh22", binary=False)


LOWER_BLOCK, UPPER_BLOCK = ((np.flatnonzero(part) + 1, TETRA[part] + 1) for part in (~UPPER, UPPER))


def abaqus_text(*blocks: tuple[str, Any], shift: float = 0.0) -> str:
    """Nodes of the block and elements under each keyword of ``blocks``, whose (numbers, nodes) follow it."""
    nodes = "".join(f"{k}, {x + shift:.9g}, {y:.9g}, {z:.9g}\n" for k, (x, y, z) in enumerate(CORNERS, start=1))
    cells = "".join(
        f"*ELEMENT, {head}\n" + "".join(f"{e}, {', '.join(map(str, t))}\n" for e, t in zip(*block, strict=True))
        for head, block in blocks
    )
    return f"*NODE\n{nodes}{cells}"


PLAIN = abaqus_text(("TYPE=C3D4, ELSET=lower", LOWER_BLOCK), ("TYPE=C3D4, ELSET=upper", UPPER_BLOCK))
MOVED = abaqus_text(("TYPE=C3D4, ELSET=lower", LOWER_BLOCK), ("TYPE=C3D4, ELSET=upper", UPPER_BLOCK), shift=-0.01)
SPLIT = tuple((half[0][:n], half[1][:n]) for half, n in ((LOWER_BLOCK, 100),))
REST_OF_IT = (LOWER_BLOCK[0][100:], LOWER_BLOCK[1][100:])


def abaqus(text: str = PLAIN, **others: str) -> Callable[[Path], None]:
    """Writer of an Abaqus file as other programs write it, and of those that it includes."""

    def write(folder: Path) -> None:
        (folder / "limb.inp").write_text(text)
        for name, content in others.items():
            (folder / f"{name}.inp").write_text(content)

    return write


def of_abaqus(name: str, write: Callable[[Path], None], *says: str) -> Brought:
    return of_mesh(name, write, *says, file="limb.inp", regions={"lower": "muscle", "upper": "fat"})


def med(folder: Path) -> None:
    """Groups with names, of which each cell has two, beside a field of results."""
    made = meshio.Mesh(CORNERS, [("tetra", TETRA)], cell_data={"cell_tags": [-NUMBERS], "heat": [np.ones(len(TETRA))]})
    made.cell_tags = {-1: ["arm", "all"], -2: ["wrap", "all"]}
    made.write(folder / "limb.med")


def gmsh_turned(folder: Path) -> None:
    """Cells of one physical group turned round, which gmsh marks by a negative number."""
    gmsh_named(folder)
    lines = (folder / "limb.msh").read_text().splitlines()
    turned_ = [" ".join([*w[:3], f"-{w[3]}", *w[4:]]) if len(w := x.split()) == 9 and w[3] == "1" else x for x in lines]
    (folder / "limb.msh").write_text("\n".join(turned_) + "\n")


def with_a_brick(folder: Path) -> None:
    bricks = [("tetra", TETRA), ("wedge", np.array([[0, 1, 2, 3, 4, 5]]))]
    meshio.Mesh(CORNERS, bricks, cell_data={"region": [NUMBERS, np.array([1])]}).write(folder / "limb.vtu")


def with_skin_triangles(folder: Path) -> None:
    """Cells of other kinds beside the tetrahedra, with region numbers of their own."""
    both = [("triangle", TETRA[:5, :3]), ("tetra", TETRA), ("line", TETRA[:4, :2])]
    numbers = [np.full(5, 9), NUMBERS, np.full(4, 8)]
    meshio.Mesh(CORNERS, both, cell_data={"region": numbers}).write(folder / "limb.vtu")


MESHES = (
    of_mesh("valid mesh", cells()),
    of_mesh("regions as floats that are whole", cells(region=NUMBERS.astype(float))),
    of_mesh("regions as a column", cells(region=NUMBERS[:, None])),
    of_mesh("tetrahedra clockwise", cells(tetrahedra=TETRA[:, [0, 2, 1, 3]])),
    of_mesh("half of them clockwise", cells(tetrahedra=np.vstack([TETRA[:300, ::-1], TETRA[300:]]))),
    of_mesh("tetra10 with straight edges", cells(*quadratic())),
    of_mesh("vertices doubled between tissues", cells(*doubled())),
    of_mesh("vertices that nothing uses, not finite", cells(points=np.vstack([CORNERS, [[np.nan] * 3]]))),
    of_mesh("millimetres with their unit", cells(points=CORNERS * 1e3), unit=1e-3),
    of_mesh("single precision", cells(points=CORNERS.astype(np.float32))),
    of_mesh("triangles and lines beside the tetrahedra", with_skin_triangles),
    of_mesh("gmsh with names", gmsh_named, file="limb.msh", regions={"arm": "muscle", "wrap": "fat"}),
    of_mesh("gmsh with numbers for names", gmsh_named, file="limb.msh"),
    of_mesh("element sets", with_sets(SETS), file="limb.inp", regions={"lower": "muscle", "upper": "fat"}),
    of_mesh(
        "element sets, one of them of all cells",
        with_sets({**SETS, "all": [np.arange(len(TETRA))]}),
        file="limb.inp",
        regions={"lower": "muscle", "upper": "fat"},
    ),
    of_mesh(
        "element sets that overlap",
        with_sets({"lower": [np.arange(len(TETRA))], "upper": SETS["upper"]}),
        "is in the sets 'lower' and 'upper'",
        file="limb.inp",
        regions={"lower": "muscle", "upper": "fat"},
    ),
    of_abaqus("Abaqus, as others write it", abaqus()),
    of_abaqus("Abaqus, comments among the nodes", abaqus(PLAIN.replace("\n5,", "\n** five\n5,"))),
    of_abaqus(
        "Abaqus, a set in two blocks",
        abaqus(
            abaqus_text(
                ("TYPE=C3D4H, ELSET=lower", REST_OF_IT),
                ("TYPE=C3D4H, ELSET=upper", UPPER_BLOCK),
                ("TYPE=C3D4H, ELSET=lower", SPLIT[0]),
            )
        ),
    ),
    of_abaqus(
        "Abaqus, sets of sets",
        abaqus(
            abaqus_text(
                ("TYPE=C3D4, ELSET=a", UPPER_BLOCK),
                ("TYPE=C3D4, ELSET=b", REST_OF_IT),
                ("TYPE=C3D4, ELSET=c", SPLIT[0]),
            )
            + "*ELSET, ELSET=upper\na\n*ELSET, ELSET=lower\nC, b\n"
        ),
    ),
    of_abaqus(
        "Abaqus, an instance that stays",
        abaqus(f"*PART, NAME=arm\n{PLAIN}*END PART\n*INSTANCE, NAME=i, PART=arm\n*END INSTANCE\n"),
    ),
    of_abaqus(
        "Abaqus, an instance that is moved",
        abaqus(f"*PART, NAME=arm\n{MOVED}*END PART\n*INSTANCE, NAME=i, PART=arm\n0.01, 0, 0\n*END INSTANCE\n"),
    ),
    of_abaqus(
        "Abaqus, two parts that nothing places",
        abaqus(f"*PART, NAME=a\n{PLAIN}*END PART\n*PART, NAME=b\n{PLAIN}*END PART\n"), "2 parts and no *INSTANCE",
    ),
    of_abaqus(
        "Abaqus, a part that is elsewhere",
        abaqus(f"*PART, NAME=a\n{PLAIN}*END PART\n*INSTANCE, NAME=i, PART=b\n*END INSTANCE\n"), "the part 'b'",
    ),
    of_abaqus("Abaqus, nodes of a system", abaqus("*SYSTEM\n0, 0, 1\n" + PLAIN), "*SYSTEM", "in x, y, z"),
    of_abaqus("Abaqus, included files", abaqus("*INCLUDE, INPUT=more.inp\n", more=PLAIN)),
    of_abaqus(
        "Abaqus, an included file that is missing", abaqus("*INCLUDE, INPUT=more.inp\n"), "more.inp: no such file"
    ),
    of_abaqus("Abaqus, a node that is missing", abaqus(PLAIN.replace("\n5, ", "\n5005, ")), "names node 5,"),
    of_abaqus("Abaqus, bricks", abaqus(PLAIN + "*ELEMENT, TYPE=C3D8R\n9999, 1,2,3,4,5,6,7,8\n"), "C3D8R", "split them"),
    of_abaqus("Abaqus, a word for a number", abaqus(PLAIN.replace("\n7, ", "\nseven, ")), "line 8", "no numbers"),
    of_mesh("MED with groups and a field", med, file="limb.med", regions={"arm": "muscle", "wrap": "fat"}),
    of_mesh("gmsh with a name and a number", gmsh_named, file="limb.msh", regions={"arm": "muscle", "2": "fat"}),
    of_mesh("gmsh with turned cells", gmsh_turned, file="limb.msh", regions={"arm": "muscle", "wrap": "fat"}),
    of_mesh("region array of three columns", cells(region=np.tile(NUMBERS[:, None], 3)), "(768, 3)", "one number"),
    of_mesh("region that is a fraction", cells(region=changed(NUMBERS.astype(float), 5, 1.7)), "1.7 of number 5"),
    of_mesh("region that is no number", cells(region=changed(NUMBERS.astype(float), 7, np.nan)), "nan of number 7"),
    of_mesh("no regions", cells(region=None), "768 tetrahedra carry no region"),
    of_mesh("every cell twice", cells(tetrahedra=np.vstack([TETRA, TETRA]), region=np.tile(NUMBERS, 2)), "occur twice"),
    of_mesh("index beyond the vertices", cells(tetrahedra=changed(TETRA, (3, 2), 9999)), "number 3 with vertex 9999"),
    of_mesh("index below zero", cells(tetrahedra=changed(TETRA, (3, 2), -1)), "number 3 with vertex -1"),
    of_mesh("a vertex twice in a cell", cells(tetrahedra=changed(TETRA, (4, 1), TETRA[4, 0])), "no volume", "number 4"),
    of_mesh(
        "cell without volume",
        cells(FLAT, np.vstack([TETRA, [[0, 3, 27, N]]]), np.append(NUMBERS, 1)),
        "flatter than mesh.min_quality",
        "number 768",
    ),
    of_mesh("all cells without volume", cells(points=CORNERS * [1, 1, 0]), "flat", "in z"),
    of_mesh("vertex that is not finite", cells(points=changed(CORNERS, (40, 1), np.nan)), "not finite", "vertex 40"),
    of_mesh("infinite vertex", cells(points=changed(CORNERS, (7, 1), np.inf)), "not finite"),
    of_mesh("folded over", cells(points=FOLDED), "same side of the face"),
    of_mesh(
        "three cells on one face",
        cells(
            np.vstack([CORNERS, [[0.0, 0.0, 0.3e-1]]]),
            np.vstack([TETRA, [[*TETRA[100][:3], N]]]),
            np.append(NUMBERS, 1),
        ),
        "all share one face",
    ),
    of_mesh("a cell apart", cells(APART, np.vstack([TETRA, [np.arange(N, N + 4)]]), np.append(NUMBERS, 1)), "2 parts"),
    of_mesh(
        "a cell missing inside",
        cells(FINE, np.delete(FINE_TETRA, inside(), axis=0), ONES[1:]),
        "cavities",
        "4 facets",
        **MUSCLE,
    ),
    of_mesh(
        "a cell missing beside the skin",
        cells(FINE, np.delete(FINE_TETRA, on_an_edge(), axis=0), ONES[1:]),
        "touches itself",
        **MUSCLE,
    ),
    of_mesh("tetra10 with a bent edge", cells(*quadratic(1e-3)), "bent edges", "number 0"),
    of_mesh("millimetres", cells(points=CORNERS * 1e3), "0.001 (millimetres) makes it 0.08 m"),
    of_mesh(
        "centimetres taken for millimetres",
        cells(points=CORNERS * 100),
        "limb.unit = 0.001 right, or should it be 0.01",
        unit=1e-3,
    ),
    of_mesh("far from the device", cells(points=CORNERS + np.array([0.5, 0, 0])), "x 460 to 540", "move the limb"),
    of_mesh("wedges among the tetrahedra", with_a_brick, "wedge", "only tetrahedra can be used"),
    of_mesh("region without a tissue", cells(region=changed(NUMBERS, 9, 5)), "regions 5", "tetrahedron 9"),
    of_mesh(
        "two hundred regions",
        cells(region=np.arange(len(TETRA))),
        "and 763 more",
    ),
)


def shell(size: Any = (120, 70, 60), *, at: Any = (0, 0, 0), cuts: int = 2) -> trimesh.Trimesh:
    """A closed box [mm], its top at z = half its height."""
    body = trimesh.creation.box(extents=size)
    for _ in range(cuts):
        body = body.subdivide()
    body.apply_translation(at)
    return body


def put(**bodies: Any) -> Callable[[Path], None]:
    """Writer of STL files by tissue; a body may also be (vertices, faces)."""

    def write(folder: Path) -> None:
        for tissue, body in bodies.items():
            made = body if isinstance(body, trimesh.Trimesh) else trimesh.Trimesh(body[0], body[1], process=False)
            made.export(folder / f"{tissue}.stl")

    return write


def of_surfaces(name: str, write: Callable[[Path], None], *says: str, ending: str = "stl", **limb: Any) -> Brought:
    table = {
        "shape": "surfaces",
        "unit": 1e-3,
        "surfaces": {"skin": f"skin.{ending}", "muscle": f"muscle.{ending}"},
        **limb,
    }
    return Brought(name, write, table, says)


SKIN, MUSCLE_BODY = shell(), shell((120, 60, 50))
VERTICES, FACES = np.array(SKIN.vertices), np.array(SKIN.faces)


def as_files(ending: str, **options: Any) -> Callable[[Path], None]:
    """The two boxes in another format."""

    def write(folder: Path) -> None:
        SKIN.export(folder / f"skin.{ending}", **options)
        MUSCLE_BODY.export(folder / f"muscle.{ending}", **options)

    return write


def joined(*bodies: Any) -> Any:
    return trimesh.util.concatenate(bodies)


def turned(body: trimesh.Trimesh) -> trimesh.Trimesh:
    """Inside out."""
    return trimesh.Trimesh(body.vertices, np.array(body.faces)[:, ::-1], process=False)


def text_file(folder: Path) -> None:
    put(muscle=MUSCLE_BODY)(folder)
    (folder / "skin.stl").write_text("PK this is no surface")


def points_only(folder: Path) -> None:
    trimesh.PointCloud(VERTICES).export(folder / "skin.ply")
    MUSCLE_BODY.export(folder / "muscle.ply")


def bad_index(folder: Path) -> None:
    MUSCLE_BODY.export(folder / "muscle.obj")
    lines = [f"v {x} {y} {z}" for x, y, z in VERTICES] + ["f 1 2 3", "f 1 2 9999"]
    (folder / "skin.obj").write_text("\n".join(lines) + "\n")


def cut_binary(folder: Path) -> None:
    put(skin=SKIN, muscle=MUSCLE_BODY)(folder)
    whole = (folder / "skin.stl").read_bytes()
    (folder / "skin.stl").write_bytes(whole[: len(whole) // 2])


BOTH = {"muscle": MUSCLE_BODY}
BONY = {"surfaces": {"skin": "skin.stl", "muscle": "muscle.stl", "bone": "bone.stl"}}
INNER = shell((120, 12, 12))
TWO_BONES = joined(shell((120, 10, 10), at=(0, -14, 0)), turned(shell((120, 10, 10), at=(0, 14, 0))))
EXTRA_WALL = np.vstack([FACES, [[FACES[0, 0], FACES[0, 1], FACES[90, 2]]]])

SURFACES = (
    of_surfaces("valid surfaces", put(skin=SKIN, **BOTH)),
    of_surfaces("text STL", as_files("stl", file_type="stl_ascii")),
    of_surfaces("OBJ", as_files("obj"), ending="obj"),
    of_surfaces("PLY", as_files("ply"), ending="ply"),
    of_surfaces("inside out", put(skin=turned(SKIN), **BOTH)),
    of_surfaces("two bones in a file, one inside out", put(skin=SKIN, bone=TWO_BONES, **BOTH), **BONY),
    of_surfaces("triangles without area", put(skin=(VERTICES, np.vstack([FACES, [[5, 5, 9]]])), **BOTH)),
    of_surfaces(
        "metres", put(skin=SKIN.copy().apply_scale(1e-3), muscle=MUSCLE_BODY.copy().apply_scale(1e-3)), unit=1.0
    ),
    of_surfaces(
        "a hole", put(skin=(VERTICES, FACES[4:]), **BOTH), "not closed (watertight)", "open edges, the first at"
    ),
    of_surfaces("faces both ways", put(skin=(VERTICES, changed(FACES, 7, FACES[7, ::-1])), **BOTH), "face both ways"),
    of_surfaces("every face twice", put(skin=(VERTICES, np.vstack([FACES, FACES])), **BOTH), "occur twice", "skin"),
    of_surfaces("a face twice", put(skin=(VERTICES, np.vstack([FACES, FACES[3:4]])), **BOTH), "number 192", "as 3"),
    of_surfaces("an inner wall", put(skin=(VERTICES, EXTRA_WALL), **BOTH), "skin", "open|more than two"),
    of_surfaces(
        "a vertex not finite", put(skin=(changed(VERTICES, 9, np.nan), FACES), **BOTH), "not finite", "first is"
    ),
    of_surfaces("flat", put(skin=(VERTICES * [1, 1, 0], FACES), **BOTH), "is flat, 0 mm in z"),
    of_surfaces("millimetres for metres", put(skin=SKIN, **BOTH), "0.001 (millimetres) makes it 0.12 m", unit=1.0),
    of_surfaces(
        "metres for millimetres", put(skin=SKIN.copy().apply_scale(1e-3), **BOTH), "1 (metres) makes it 0.12 m"
    ),
    of_surfaces(
        "centimetres for millimetres",
        put(skin=SKIN.copy().apply_scale(0.1), muscle=MUSCLE_BODY.copy().apply_scale(0.1)),
        "limb.unit = 0.001 right, or should it be 0.01",
    ),
    of_surfaces(
        "inches for millimetres",
        put(skin=SKIN.copy().apply_scale(1 / 25.4), muscle=MUSCLE_BODY.copy().apply_scale(1 / 25.4)),
        "limb.unit = 0.001 right, or should it be 0.01 (centimetres) or 0.0254 (inches)",
    ),
    of_surfaces("centimetres for decimetres", put(skin=SKIN, **BOTH), "tetrahedra, mesh.max_elements", unit=0.012),
    of_surfaces("identical", put(skin=SKIN, muscle=SKIN), "'skin' and 'muscle' are the same"),
    of_surfaces("identical, cut more finely", put(skin=SKIN, muscle=shell(cuts=3)), "are the same"),
    of_surfaces("crossing", put(skin=SKIN, muscle=shell((120, 60, 50), at=(0, 9, 0))), "cross in", "the first at"),
    of_surfaces("beside each other", put(skin=SKIN, muscle=shell((120, 20, 20), at=(0, 90, 0))), "mm out of 'skin'"),
    of_surfaces(
        "limb and a speck", put(skin=joined(SKIN, shell((3, 3, 3), at=(0, 0, 60))), **BOTH), "2 separate bodies"
    ),
    of_surfaces("hollow", put(skin=joined(SKIN, turned(shell((9, 9, 9)))), **BOTH), "cavity at (0.0, 0.0, 0.0) mm"),
    of_surfaces(
        "surfaces far from the device",
        put(skin=shell(at=(300, 0, 0)), muscle=shell((120, 60, 50), at=(300, 0, 0))),
        "x 240 to 360",
        "move the limb",
    ),
    of_surfaces(
        "bone outermost", put(bone=SKIN, **BOTH), "largest surface is the bone's", surfaces={"bone": "bone.stl"}
    ),
    of_surfaces("no such file", put(skin=SKIN), "muscle.stl: no such surface"),
    of_surfaces("no surface at all", text_file, "skin.stl: cannot be read|holds no triangles"),
    of_surfaces("points without triangles", points_only, "holds no triangles", ending="ply"),
    of_surfaces("a face of vertices that are not there", bad_index, "skin.obj", ending="obj"),
    of_surfaces("binary STL cut in half", cut_binary, "skin.stl"),
)
BROUGHT = MESHES + SURFACES


def _main() -> None:
    from forearm_fem.errors import ForearmError
    from forearm_fem.geometry.build import build_mesh
    from forearm_fem.scenario import parse_scenario

    for case in BROUGHT:
        with tempfile.TemporaryDirectory() as folder:
            case.write(Path(folder))
            try:
                mesh = build_mesh(parse_scenario(case.scenario()), base=Path(folder))
                said = f"- {len(mesh.tetrahedra)} tetrahedra, {mesh.region_names}"
            except ForearmError as problem:
                said = str(problem).replace(f"{folder}/", "")
            print(f"| {case.name} | {said} |")


if __name__ == "__main__":
    _main()
