"""Small valid files of every type that the library reads, and their readers."""

import io
import json
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import gltf_contents
import numpy as np
import trimesh
from astropy.io import fits
from oracles import measured, mitsuba_pictures
from raw_contents import dng
from scene_texts import PBRT, PBRT_SURFACES, PLY

import jaxvision
from fitting.noise.levels_table import read_table
from fitting.rig import load_rig
from jaxvision.brdf.measured import BRDFSamples
from jaxvision.files import measured as measured_files
from jaxvision.files.cameras import read_camera, shipped_cameras
from jaxvision.files.image_settings import read_settings
from jaxvision.files.images import read_image, write_image
from jaxvision.files.materials import read_material, write_material
from jaxvision.files.meshes import read_mesh
from jaxvision.files.scenes import read_scene

from . import kept

SHIPPED = Path(jaxvision.__file__).parent / "files" / "shipped"
RNG = np.random.default_rng(3)


class Kind(NamedTuple):
    """A type of file.

    Attributes:
        suffix: suffix of its name.
        seeds: contents of valid files.
        read: function that reads one; its result is a tree of arrays.
        finite: whether all numbers of a result must be finite.
    """

    suffix: str
    seeds: tuple[bytes, ...]
    read: Callable[[Path], object]
    finite: bool = True


TETRAHEDRON = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
vn 0 0 1
f 1 3 2
f 1 2 4
f 2 3 4
f 1 4 3
"""
TABLE = """\
exposure_ms,photons_per_pixel,mean_bright_DN,var_bright_DN2,mean_dark_DN,var_dark_DN2,pixels
1,50,72.5,12.6,60.1,9.4,10000
1,100,85.1,15.7,60.1,9.4,10000
1,500,185.0,40.7,60.1,9.4,10000
1,2000,560.2,134.4,60.1,9.4,10000
1,5000,1310.1,321.9,60.1,9.4,10000
1,10000,2560.4,634.1,60.1,9.4,10000
"""
RIG = """[camera]
bits = 12
black_level = 60.0
gain = 0.25

[[flat]]
files = ["a.tif", "b.tif"]
exposure = 0.001
photons = 961.0

[[dark]]
files = ["c.tif", "d.tif"]
exposure = 0.001

[[exposure]]
file = "s.png"
exposure = 0.03125
group = "450nm"

[[light]]
file = "l.tif"
direction = [0.0, 0.6, 0.8]
intensity = [1.0, 1.0, 1.0]

[geometry]
sphere = { centre = [63.5, 63.5], radius = 57.6 }
"""


def written(folder: Path, name: str, write: Callable[[Path], object]) -> bytes:
    """Return the bytes that a writer puts into a file."""
    file = folder / name
    write(file)
    return file.read_bytes()


def picture(folder: Path, suffix: str, dtype: type) -> bytes:
    values = RNG.uniform(size=(5, 7, 3))
    whole = (values * np.iinfo(dtype).max).astype(dtype) if dtype is not np.float32 else values
    return written(folder, f"seed{suffix}", lambda file: write_image(file, whole.astype(dtype)))


def numpy_file() -> bytes:
    file = io.BytesIO()
    np.save(file, RNG.uniform(size=(4, 5)))
    return file.getvalue()


def binary_gltf(content: bytes) -> bytes:
    """Return a `.glb` of one chunk."""
    content += b" " * (-len(content) % 4)
    chunk = struct.pack("<I4s", len(content), b"JSON") + content
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


def astronomical(folder: Path) -> bytes:
    codes = RNG.integers(0, 4096, (6, 5)).astype(np.uint16)
    unit = fits.PrimaryHDU(codes)
    unit.header["EXPTIME"] = 0.5
    return written(folder, "seed.fits", unit.writeto)


def glossy(theta_i: np.ndarray, theta_o: np.ndarray) -> BRDFSamples:
    """Return samples in the plane of incidence, opposite the light, at two wavelengths."""
    lobe = 0.1 + 0.4 * np.exp(-(((theta_i - theta_o) / 0.2) ** 2))
    values = np.stack([lobe, 0.7 * lobe], axis=-1)
    return BRDFSamples(
        theta_i, 0 * theta_i, theta_o, 0 * theta_o + np.pi, values, np.array([5e-7, 6e-7])
    )


def pixels(file: Path) -> object:
    """Read a picture and its header."""
    read_settings(file)
    return read_image(file)


def targa() -> bytes:
    """Return a TGA of 4 x 3 colours from the top left, as runs of two equal ones."""
    head = struct.pack("<BBBHHBHHHHBB", 0, 0, 10, 0, 0, 0, 0, 0, 4, 3, 24, 0x20)
    return head + b"".join(bytes((0x81, i, 2 * i, 200 - i)) for i in range(6))


def kinds(folder: Path) -> dict[str, Kind]:
    """Return every type by name. `folder` is for writers, and for files that other files name."""
    cameras = tuple((SHIPPED / "cameras" / f"{n}.toml").read_bytes() for n in shipped_cameras())
    scenes = tuple(file.read_bytes() for file in sorted((SHIPPED / "scenes").glob("*.toml")))
    for table in (SHIPPED / "scenes").glob("*.csv"):  # for the scenes that name them
        (folder / table.name).write_bytes(table.read_bytes())
    mitsuba_pictures.write_scenes(folder)
    write_image(folder / "sky.exr", mitsuba_pictures.sky())
    mitsuba = tuple(text.encode() for text in mitsuba_pictures.SCENES.values())
    pbrt = tuple(text.encode() for text in (PBRT, PBRT_SURFACES))
    gltf = json.dumps(gltf_contents.content(), indent=1).encode()
    ball = written(folder, "seed.stl", trimesh.creation.icosphere(subdivisions=0).export)
    own = kept.sound(folder)
    merl = measured.merl_bytes(
        lambda h, d, p: np.full((*h.shape, 3), 0.2) + h[..., None], (6, 4, 6)
    )
    rgl = measured.tensor_bytes(measured.rgl_fields(np.random.default_rng(2)))
    four = np.array([0.1, 0.3, 0.5, 0.7])
    grid = np.meshgrid(np.linspace(0.1, 1.3, 6), np.linspace(0.1, 1.3, 7))
    cornell = tuple(
        written(folder, "seed.brdf", partial(measured_files.write_cornell, samples=glossy(*angles)))
        for angles in ((four, four[::-1]), [angle.ravel() for angle in grid])
    )
    material = written(
        folder,
        "seed_material.toml",
        lambda file: write_material(jaxvision.Phong([0.2, 0.1], [0.3, 0.3], 9.0), file),
    )
    return {
        "camera": Kind(".toml", cameras, read_camera, finite=False),  # a full well may be infinite
        "scene": Kind(".toml", scenes, lambda file: read_scene(file).scene),
        "mitsuba": Kind(".xml", mitsuba, lambda file: read_scene(file).scene),
        "pbrt": Kind(".pbrt", pbrt, lambda file: read_scene(file).scene),
        "gltf": Kind(".gltf", (gltf,), lambda file: read_scene(file).scene),
        "material": Kind(".toml", (material,), read_material),
        "rig": Kind(".toml", (RIG.encode(),), load_rig, finite=False),
        "levels": Kind(".csv", (TABLE.encode(),), lambda file: read_table(file, None)),
        "merl": Kind(".binary", (merl[0],), measured_files.read_merl),
        "rgl": Kind(".bsdf", (rgl,), measured_files.read_rgl),
        "cornell": Kind(".brdf", cornell, measured_files.read_cornell),
        "obj": Kind(".obj", (TETRAHEDRON.encode(),), read_mesh, finite=False),
        "ply": Kind(".ply", (PLY.encode(),), read_mesh, finite=False),
        "png": Kind(".png", (picture(folder, ".png", np.uint8),), pixels),
        "png16": Kind(".png", (picture(folder, ".png", np.uint16),), pixels),
        "tiff": Kind(".tif", (picture(folder, ".tif", np.uint16),), pixels),
        "jpeg": Kind(".jpg", (picture(folder, ".jpg", np.uint8),), pixels),
        "exr": Kind(".exr", (picture(folder, ".exr", np.float32),), pixels, finite=False),
        "hdr": Kind(".hdr", (picture(folder, ".hdr", np.float32),), pixels),
        "pgm": Kind(".pgm", (b"P5\n# codes\n4 3\n1023\n" + bytes(range(3)) * 8,), pixels),
        "ppm": Kind(".ppm", (b"P3\n2 2\n255\n" + b"9 80 200\n" * 4,), pixels),
        "pfm": Kind(".pfm", (b"PF\n2 2\n-1.0\n" + bytes(48),), pixels, finite=False),
        "tga": Kind(".tga", (targa(),), pixels),
        "fits": Kind(".fits", (astronomical(folder),), pixels, finite=False),
        "dng": Kind(".dng", (dng(RNG.integers(64, 4096, (24, 32)).astype(np.uint16)),), pixels),
        "glb": Kind(".glb", (binary_gltf(gltf),), lambda file: read_scene(file).scene),
        "glb_mesh": Kind(".glb", (binary_gltf(gltf),), read_mesh),
        "stl": Kind(".stl", (ball,), read_mesh, finite=False),
        "draws": Kind(".npz", (own["draws"],), kept.draws),
        "tiles": Kind(".partial", (own["tiles"],), kept.tiles, finite=False),
        "passes": Kind(".partial", (own["passes"],), kept.passes, finite=False),
        "chain": Kind(".npz", (own["chain"],), kept.chain, finite=False),
        "npy": Kind(".npy", (numpy_file(),), pixels, finite=False),
    }
