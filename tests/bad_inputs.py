"""Wrong scenarios and meshes, as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bad_files import (
    CORNERS,
    CUBE,
    HEXAHEDRON,
    NAN,
    TRIANGLE,
    crossing,
    damaged_mesh,
    flat_tetrahedron,
    good_outer,
    mesh,
    millimetre_surfaces,
    missing_surface,
    open_surface,
    self_crossing,
    separate,
    some_inverted,
    text_surface,
    wavelet_of_text,
)

SLAB = """name = "bad"
[limb]
shape = "slab"
length = 0.06
width = 0.06
depth = 0.02
[mesh]
size_contact = 0.005
size_grid = 0.008
size_far = 0.015
sublayers = { skin = 1, fat = 1 }
[device]
spacing = 0.03
[device.cone]
contact = "pressure"
[sweep]
frequencies = [100.0]
[solver]
sweep = "direct"
"""
LAYERED = 'name = "bad"\nengine = "layered"\n[sweep]\nfrequencies = [100.0]\n'
BAND = 'name = "bad"\nengine = "layered"\n'
FOREARM = 'name = "bad"\n'
SURFACES = """name = "bad"
[limb]
shape = "surfaces"
surfaces = { skin = "skin.stl", muscle = "muscle.stl" }
[device]
spacing = 0.02
[sweep]
frequencies = [100.0]
"""
MESH = """name = "bad"
[limb]
shape = "mesh"
file = "limb.vtu"
regions = { "1" = "muscle" }
[device]
spacing = 0.02
[sweep]
frequencies = [100.0]
"""


@dataclass(frozen=True)
class Case:
    """A mistake: scenario text, overrides, the files beside it, and words that its sentence must hold."""

    name: str
    text: str | bytes | None
    says: tuple[str, ...]
    overrides: tuple[str, ...] = ()
    files: Callable[[Path], None] | None = None
    command: tuple[str, ...] = ("run", "--until", "solve")
    left: tuple[str, ...] = ()  # finished stages that stay


CASES: tuple[Case, ...] = (
    Case("no such scenario", None, ("no such file",)),
    Case("truncated TOML", SLAB[: SLAB.index('"slab"') + 3], ("not valid TOML",)),
    Case("a picture instead of a scenario", b"\x89PNG\r\n\x1a\n\xff\xfe", ("cannot be read as a text file",)),
    Case("unknown key", SLAB + "[divice]\nspacing = 0.04\n", ("divice", "unknown key", "mean device?")),
    Case("key of another table", SLAB, ("sweep.backend", "mean solver.backend?"), ("sweep.backend='superlu'",)),
    Case("key like no other", SLAB, ("colour", "`forearm-fem schema` lists"), ("colour=1",)),
    Case("unknown key in a table", SLAB, ("device.spacings", "mean device.spacing?"), ("device.spacings=0.04",)),
    Case("text for a number", SLAB, ("device.spacing", "valid number"), ("device.spacing='wide'",)),
    Case("NaN", LAYERED, ("device.spacing", "finite"), ("device.spacing=nan",)),
    Case("infinite modulus", LAYERED, ("tissues.override.skin.mu", "finite"), ("tissues.override.skin.mu=inf",)),
    Case(
        "negative modulus",
        LAYERED,
        ("tissues.override.skin.mu", "Pa", "-13000"),
        ("tissues.override.skin.mu=-13e3",),
    ),
    Case(
        "negative viscosity",
        LAYERED,
        ("tissues.override.fat.eta", "expected 0, or", "Pa s, got -1"),
        ("tissues.override.fat.eta=-1",),
    ),
    Case("density in g/cm^3", LAYERED, ("density", "100"), ("tissues.override.skin.density=1.1",)),
    Case("unknown preset", LAYERED, ("tissues.preset", "'default'"), ("tissues.preset='human'",)),
    Case("unknown limb shape", LAYERED, ("limb", "forearm"), ("limb.shape='leg'",)),
    Case("unknown renderer", LAYERED, ("rendering.methods", "funneling"), ("rendering.methods=['magic']",)),
    Case("f_max = 0", BAND, ("sweep.f_max", "to 5000 Hz, got 0"), ("sweep.f_max=0",)),
    Case("f_max below f_min", BAND, ("f_max must exceed f_min",), ("sweep.f_max=5",)),
    Case("sample_rate too low", BAND, ("sample_rate must be at least",), ("sweep.sample_rate=800",)),
    Case(
        "frequencies not increasing",
        LAYERED,
        ("frequencies must increase",),
        ("sweep.frequencies=[200.0, 100.0]",),
    ),
    Case(
        "record too short for a bin",
        'name = "bad"\nengine = "layered"\n',
        ("no bin",),
        ("sweep.f_min=310", "sweep.f_max=390", "sweep.duration=0.005"),
    ),
    Case("target not in the grid", LAYERED, ("['12']", "1..9"), ("rendering.targets=['12']",)),
    Case("zero point not in the grid", LAYERED, ("['Z']", "1..9"), ("rendering.zeros=['Z']",)),
    Case("actuator that does not exist", LAYERED, ("out_of_contact", "A4"), ("device.out_of_contact=['A7']",)),
    Case("spacing in mm by mistake", LAYERED, ("device.spacing", "0.3", "45"), ("device.spacing=45",)),
    Case("limb length in mm by mistake", SLAB, ("limb.length", "to 2 m, got 120"), ("limb.length=120",)),
    Case(
        "layer of a tissue that does not exist",
        LAYERED,
        ("no tissue is called 'gristle'",),
        ("limb.layers=[{tissue='gristle', thickness=0.001}]",),
    ),
    Case("new tissue stated half", LAYERED, ("gel", "also needs"), ("tissues.override.gel.mu=1000.0", "limb.core=gel")),
    Case("parameter without effect", LAYERED, ("has no effect",), ("tissues.override.skin.exponent=0.3",)),
    Case("layered engine for a user's mesh", MESH, ("needs layers",), ("engine='layered'",)),
    Case(
        "wavelet file missing",
        LAYERED.replace("frequencies = [100.0]", "f_max = 300.0\nduration = 0.25\nsample_rate = 2000.0"),
        ("nowhere.csv",),
        ("rendering.wavelet.file='nowhere.csv'",),
        command=("render",),
    ),
    Case(
        "wavelet file without numbers",
        LAYERED.replace("frequencies = [100.0]", "f_max = 300.0\nduration = 0.25\nsample_rate = 2000.0"),
        ("wave.csv",),
        ("rendering.wavelet.file='wave.csv'",),
        wavelet_of_text,
        ("render",),
    ),
    Case(
        "layer thicker than the slab",
        SLAB,
        ("thick together", "limb.depth"),
        ("limb.layers=[{tissue='skin', thickness=0.03}]",),
    ),
    Case(
        "layer thicker than the forearm",
        FOREARM,
        ("thick together",),
        ("limb.layers=[{tissue='fat', thickness=0.05}]",),
        command=("run", "--until", "mesh"),
    ),
    Case("contact off the slab", SLAB, ("contact A1", "does not lie"), ("device.spacing=0.08",)),
    Case(
        "contact off the forearm", FOREARM, ("contact A1",), ("device.spacing=0.2",), command=("run", "--until", "mesh")
    ),
    Case("contacts overlapping", SLAB, ("contacts A1 and A2", "apart"), ("device.spacing=0.006",)),
    Case("grid point off the slab", SLAB, ("grid point 1",), ("grid.pitch=0.05",)),
    Case("symmetry through contacts beside the plane", SLAB, ("limb.symmetry",), ("limb.symmetry=['x']",)),
    Case(
        "bone out of the muscle",
        FOREARM,
        ("bone 'radius'",),
        ("limb.bones=[{name='radius', y=0.034, depth=0.023, diameter=0.014}]",),
        command=("run", "--until", "mesh"),
    ),
    Case(
        "bones through each other",
        FOREARM,
        ("bones", "radius", "ulna"),
        (
            "limb.bones=[{name='radius', y=0.0, depth=0.03, diameter=0.014},"
            " {name='ulna', y=0.004, depth=0.03, diameter=0.014}]",
        ),
        command=("run", "--until", "mesh"),
    ),
    Case(
        "memory limit too small",
        SLAB,
        ("memory_limit", "raise the limit"),
        ("solver.memory_limit=1e6",),
        left=("mesh.vtu", "scenario.json"),
    ),
    Case("no contact", LAYERED, ("device", "contacts is empty", "leave the key out"), ("device.contacts=[]",)),
    Case("no grid point", LAYERED, ("grid", "points is empty", "leave the key out"), ("grid.points=[]",)),
    Case("no frequency", LAYERED, ("sweep", "frequencies is empty"), ("sweep.frequencies=[]",)),
    Case("all out of contact", LAYERED, ("names every actuator",), ("device.out_of_contact=['A1','A2','A3','A4']",)),
    Case("force factor of 1e300", LAYERED, ("force_factor", "T m, got 1e+300"), ("device.coil.force_factor=1e300",)),
    Case("mass of 1e300", LAYERED, ("housing.mass", "kg, got 1e+300"), ("device.housing.mass=1e300",)),
    Case("denormal viscosity", LAYERED, ("fat.eta", "Pa s, got 1e-310"), ("tissues.override.fat.eta=1e-310",)),
    Case("truth for a mass", LAYERED, ("housing.mass", "valid number", "True"), ("device.housing.mass=true",)),
    Case("angle in degrees by mistake", LAYERED, ("device.rotation", "rad, got 45"), ("device.rotation=45",)),
    Case("record of 30 000 years", LAYERED, ("sweep.duration", "to 10000 s"), ("sweep.duration=1e12",)),
    Case("record of 100 million samples", LAYERED, ("duration times sample_rate", "shorten"), ("sweep.duration=1e4",)),
    Case("20 kHz", LAYERED, ("sweep.frequencies.0", "5000 Hz, got 20000"), ("sweep.frequencies=[20000]",)),
    Case(
        "date for a number", LAYERED, ("device.spacing", "valid number", "2020-01-01"), ("device.spacing=2020-01-01",)
    ),
    Case("date in the file", LAYERED + "duration = 2020-01-01T10:00:00Z\n", ("sweep.duration", "valid number", "2020")),
    Case("name of the folder above", LAYERED, ("name", "letters", "'..'"), ("name='..'",)),
    Case("name with a slash", LAYERED, ("name", "letters", "'a/b'"), ("name='a/b'",)),
    Case("control character", LAYERED, ("description", "control characters"), ('description="a\\u0007"',)),
    Case("text of 10 000 characters", LAYERED, ("limb.core:", "at most 4000"), (f"limb.core='{'x' * 10_000}'",)),
    Case("points at one place", LAYERED, ("points 1 and 2", "0.01 mm"), ("grid.points=[[0.0, 0.0], [1e-5, 0.0]]",)),
    Case("lists in lists", LAYERED, ("levels deep",), (f"grid.points={'[' * 40}{']' * 40}",)),
    Case("lists in lists in the file", LAYERED + f"x = {'[' * 4000}{']' * 4000}\n", ("nested too deeply",)),
    Case("number of 5000 digits", LAYERED + f"duration = {'9' * 5000}\n", ("a number has more than 4300 digits",)),
    Case(
        "springpot without viscosity",
        LAYERED,
        ("fat.eta", "no stiffness"),
        ("tissues.override.fat={law='springpot', mu=1e3, exponent=0.3, eta=0.0}",),
    ),
    Case(
        "signals that fill the memory",
        'name = "bad"\nengine = "layered"\n',
        ("GB", "fewer rendering.targets"),
        ("grid.rows=50", "grid.columns=50", "grid.pitch=0.001"),
        command=("render",),
    ),
    Case("discs that nearly touch", SLAB, ("contact A1 and A2", "0.4 mm between"), ("device.spacing=0.0074",)),
    Case("disc at the slab's side", SLAB, ("contact A1", "slab's side"), ("device.contacts=[[0.02649, 0.0]]",)),
    Case("elements of 0.1 mm", SLAB, ("tetrahedra", "mesh.max_elements"), ("mesh.size_grid=1e-4",)),
    Case("surface file missing", SURFACES, ("muscle.stl", "no such surface"), files=missing_surface),
    Case("surface file of text", SURFACES, ("muscle.stl",), files=text_surface),
    Case("open surface", SURFACES, ("skin.stl", "not closed"), files=open_surface),
    Case("normals of some triangles inverted", SURFACES, ("skin.stl", "face both ways"), files=some_inverted),
    Case("surface crossing its neighbour", SURFACES, ("'skin' and 'muscle' cross",), files=crossing),
    Case("surface crossing itself", SURFACES, ("crosses itself",), files=self_crossing),
    Case("surface outside its neighbour", SURFACES, ("'muscle' reaches",), files=separate),
    Case("surfaces in mm by mistake", SURFACES, ("limb.unit", "120 m"), files=millimetre_surfaces),
    Case(
        "bone as the outermost surface",
        SURFACES,
        ("the bone's",),
        ("limb.surfaces={bone='skin.stl'}",),
        good_outer,
    ),
    Case(
        "no surface at all",
        SURFACES.replace('{ skin = "skin.stl", muscle = "muscle.stl" }', "{}"),
        ("limb.surfaces is empty",),
    ),
    Case("mesh file missing", MESH, ("limb.vtu", "no such mesh file")),
    Case(
        "mesh file of the wrong type",
        MESH,
        ("limb.png", "no kind of mesh that is known"),
        ("limb.file='limb.png'",),
        lambda folder: _put(folder / "limb.png", b"\x89PNG\r\n"),
    ),
    Case("mesh file cut off", MESH, ("limb.vtu", "cannot be read as a mesh"), files=damaged_mesh),
    Case("surface mesh for a volume mesh", MESH, ("no tetrahedra", "triangle"), files=mesh(TRIANGLE)),
    Case("hexahedra", MESH, ("hexahedron", "only tetrahedra"), files=mesh(HEXAHEDRON, CUBE)),
    Case("mesh without regions", MESH, ("carry no region",), files=mesh(label=None)),
    Case("region with no tissue", MESH, ("regions 7 have no tissue",), files=mesh(label=7)),
    Case(
        "region name not in the file",
        MESH,
        ("limb.regions names", "tendon"),
        ("limb.regions={'1'='muscle', tendon='fat'}",),
        mesh(),
    ),
    Case("NaN in the mesh", MESH, ("not finite",), files=mesh(points=NAN)),
    Case("flat tetrahedron", MESH, ("quality",), files=flat_tetrahedron),
    Case("mesh in mm by mistake", MESH, ("limb.unit", "80 m"), files=mesh(points=1000 * CORNERS)),
)


def _put(file: Path, content: bytes) -> None:
    file.write_bytes(content)


def prepare(case: Case, folder: Path) -> list[str]:
    """Write the case's files into ``folder``; the command line that must fail."""
    if case.files is not None:
        case.files(folder)
    if isinstance(case.text, str):
        (folder / "bad.toml").write_text(case.text)
    elif case.text is not None:
        (folder / "bad.toml").write_bytes(case.text)
    overrides = [part for item in case.overrides for part in ("--set", item)]
    return [*case.command, "bad.toml", *overrides, "--out", "out"]
