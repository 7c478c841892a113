"""Convert the tables of a scene file to records.

A table corresponds to a function call. The keys of a table are the fields of a record, or the
arguments of the function that makes the record, and have the same meaning. The types of lights and
materials register their tables by `register`. The tables of shapes and cameras are defined in this
module. Lengths are in m, angles in degrees, and radiance in W m^-2 sr^-1.
"""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, is_dataclass, replace
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...brdf import families
from ...core._kinds import Measured, Photometry, Picture, Table
from ...core._types import POSITIVE, Colour, Range, members_of
from ...core._warnings import one_call
from ...errors import InputError
from ...lights import kinds
from ...optics import look_at, opencv_view
from ...scene import (
    Aperture,
    Box,
    CircularAperture,
    Diffraction,
    Disc,
    Distortion,
    Light,
    Map,
    Material,
    Orthographic,
    Pinhole,
    Plane,
    PolygonalAperture,
    Quad,
    Rim,
    Shape,
    Sphere,
    ThinLens,
    TriangleMesh,
    View,
    Wavefront,
)
from ..images import read_environment
from ..luminaires import read_luminaire
from ..measured import read_measured, table_of_samples
from ..meshes import nonempty_triangles, read_mesh
from ..records import Key, Reading, chosen, keys_of, value_of, values_of
from .bands import Bands, Quantity, band_values, reduction, spectrum_of
from .folder import Folder
from .maps import make_map, name_doubtful_normals

Point = Float[np.ndarray, "3"]
Axes = Float[np.ndarray, "3 3"]
Size = Annotated[float, POSITIVE]
Whole = Annotated[int, Range(0, 2**31 - 1)]
Count = Annotated[int, Range(1, 2**31 - 1)]
Angle = Annotated[float, Range(0, float(np.nextafter(180, 0)), above=True)]


# ---------------------------------------------------------------- shapes


def _box(*, centre: Point, half_extents: Point, rotation: Axes | None = None) -> Box:
    """A box; its front is the outside.

    Args:
        centre: (3,) m.
        half_extents: (3,) m, > 0, half of each side.
        rotation: (3, 3) no unit, rows are the unit axes of its sides in the world; by default the
            world's axes.
    """
    return Box(centre, half_extents, rotation=_checked_axes(rotation))


def _mesh(
    dtype: str = "float32",
    uv: bool = False,
    *,
    file: str,
    scale: Size | None = None,
    rotation: Axes | None = None,
    position: Point | None = None,
    matrix: Float[np.ndarray, "3 4"] | None = None,
    smooth: bool = False,
    flip: bool = False,
    primitive: tuple[Whole, Whole] | None = None,
) -> Shape:
    """Triangles from a file. Vertices are scaled, rotated and then moved, or mapped by `matrix`.

    Args:
        file: path of the mesh, relative to the scene file.
        scale: length of the mesh's unit, m; by default 1.
        rotation: (3, 3) no unit, rows are the mesh's axes in the world; by default the world's
            axes.
        position: (3,) m, of the mesh's origin in the world; by default [0, 0, 0].
        matrix: three rows of four numbers, the affine map from the mesh's points, as columns, to m
            in the world, in place of `scale`, `rotation` and `position`.
        smooth: whether to shade with normals at the vertices; otherwise triangles are flat.
        flip: whether to reverse every triangle and every normal.
        primitive: of a glTF file: the numbers, from 0, of a mesh and of a primitive in it, without
            the transform of the file's scene; by default all meshes, placed as in that scene.
    """
    placed = {"scale": scale, "rotation": rotation, "position": position}
    placed = {name: value for name, value in placed.items() if value is not None}
    if matrix is not None and placed:
        raise InputError(f"give either matrix or {', '.join(sorted(placed))}.")
    if rotation is not None:
        placed["rotation"] = _checked_axes(rotation)
    settings = {"smooth": smooth, "flip": flip, "primitive": primitive, "dtype": dtype, "uv": uv}
    return read_mesh(file, matrix=matrix, **placed, **settings)


def _triangles(
    dtype: str = "float32",
    *,
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Float[np.ndarray, "faces 3"],
    vertex_normals: Float[np.ndarray, "vertices 3"] | None = None,
    uv: Float[np.ndarray, "vertices 2"] | None = None,
) -> TriangleMesh:
    """Triangles that are given in the scene file itself.

    Args:
        vertices: (vertices, 3) m.
        faces: (faces, 3) the vertices of each triangle, from 0; counterclockwise from its front.
        vertex_normals: (vertices, 3) no unit, interpolated for shading; by default triangles are
            flat.
        uv: (vertices, 2) no unit, texture coordinates, with v downward in the picture.
    """
    if (faces % 1).any():
        raise InputError("faces must be whole numbers; correct them.")
    whole = faces.astype(int)
    if whole.size:
        rounded = vertices.astype(dtype)
        whole = nonempty_triangles("the triangles", rounded, vertices, whole)
    return TriangleMesh(vertices, whole, normals=vertex_normals, uv=uv)


SHAPES: dict[str, Callable[..., Shape]] = {
    "sphere": Sphere,
    "plane": Plane,
    "disc": Disc,
    "quad": Quad,
    "box": _box,
    "mesh": _mesh,
    "triangles": _triangles,
}


def surface_keys(
    *,
    name: str | None = None,
    material: str | None = None,
    emission: Colour | None = None,
    two_sided: bool = False,
    normals: Map | None = None,
) -> dict[str, Any]:
    """Check the keys that every table `[[surface]]` has, whatever its shape.

    Args:
        name: of the surface in messages; by default its number.
        material: the NAME of a table `[material.NAME]`; may be omitted if `emission` is given.
        emission: (bands,) W m^-2 sr^-1, the radiance of the front, equal in all directions.
        two_sided: whether the back counts as a front; otherwise it is black.
        normals: a map of (3,) shading normals; x points along growing u, z along the shape's
            normal.
    """
    if material is None and emission is None:
        raise InputError("give a material, an emission or both.")
    given = {"material": material, "emission": emission, "two_sided": two_sided}
    return given if normals is None else given | {"normals": normals}


# ---------------------------------------------------------------- cameras


def camera_keys(
    *,
    position: Point,
    target: Point,
    up: Point = (0.0, 0.0, 1.0),  # type: ignore[assignment]
    resolution: tuple[Count, Count],
) -> dict[str, Any]:
    """Convert the keys that every table `[camera]` has, whatever its kind.

    Args:
        position: (3,) m, of the camera.
        target: (3,) m, a point in the middle of the picture, at which the camera looks.
        up: (3,) direction that points up in the picture (its length is ignored).
        resolution: [rows, columns] of the picture, pixels.
    """
    forward = np.subtract(target, position)
    if not forward.any():
        raise InputError("position and target are one point; move one of them.")
    if np.linalg.norm(np.cross(forward, up)) <= 1e-9 * np.linalg.norm(forward):
        raise InputError("up lies along the line of sight; give another direction.")
    points = map(jnp.asarray, (position, target, up))
    axes = np.asarray(jax.jit(look_at)(*points))  # one small program, not twenty
    return {"position": np.asarray(position), "rotation": axes, "resolution": resolution}


def _orthographic(resolution: tuple[int, int], *, width: Size, **placed: Any) -> Orthographic:
    """Parallel projection.

    Args:
        width: m, of the part of the scene that the picture shows.
    """
    return Orthographic(pixel_pitch=width / resolution[1], resolution=resolution, **placed)


@one_call()
def _pinhole(
    resolution: tuple[int, int],
    *,
    field_of_view: Angle | None = None,
    focal_length: Size | None = None,
    pixel_pitch: Size | None = None,
    matrix: Axes | None = None,
    distortion: Float[np.ndarray, " coefficients"] | None = None,
    **placed: Any,
) -> Pinhole:
    """Central projection. The field of view is given by `field_of_view`, by `focal_length` and
    `pixel_pitch`, or by the `matrix` of an OpenCV calibration.

    Args:
        field_of_view: degrees, of the picture's width.
        focal_length: m, from the pinhole to the sensor.
        pixel_pitch: m, between pixels on the sensor.
        matrix: (3, 3) pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]].
        distortion: k1, k2, p1, p2, k3 of the calibration, in the order of OpenCV: none, four or
            five of them; with `matrix` only.
    """
    sizes = (focal_length, pixel_pitch)
    if matrix is not None:
        if sizes != (None, None) or field_of_view is not None:
            raise InputError("give a matrix, or field_of_view, or focal_length; one of them.")
        known = () if distortion is None else distortion.tolist()
        view = opencv_view(matrix, coefficients=known, resolution=resolution)
        return replace(view, **{name: jnp.asarray(value) for name, value in placed.items()})
    if distortion is not None:
        raise InputError("distortion is that of a calibration: give its matrix, too.")
    if field_of_view is not None and sizes == (None, None):  # the same picture at any focal length
        half = np.radians(field_of_view) / 2
        sizes = np.array(1.0), 2 * np.tan(half) / resolution[1]
    elif field_of_view is not None or None in sizes:
        raise InputError("give either field_of_view, or focal_length and pixel_pitch.")
    names = dict(zip(("focal_length", "pixel_pitch"), sizes, strict=True))
    return Pinhole(resolution=resolution, **names, **placed)


def _thin_lens(
    resolution: tuple[int, int],
    *,
    focal_length: Size,
    pixel_pitch: Size,
    f_number: Size,
    focus_distance: Size | None = None,
    blades: Count | None = None,
    aperture: Aperture | None = None,
    rim: Rim | None = None,
    distortion: Distortion | None = None,
    diffraction: Diffraction | Wavefront | None = None,
    **placed: Any,
) -> ThinLens:
    """Central projection through a thin lens.

    Args:
        focal_length: m.
        pixel_pitch: m, between pixels on the sensor.
        f_number: focal length over the lens's diameter, no unit.
        focus_distance: m, along the axis from the lens to the plane in focus, beyond the focal
            length; by default infinity.
        blades: number of the aperture's blades, at least 3, for an aperture that is a regular
            polygon; by default the aperture is round.
        aperture: instead of `blades`, a table with `kind` and the fields of an aperture of Python,
            such as `{ kind = "AnnularAperture", obstruction = 0.4 }`.
        rim: a table with `distance` and `diameter` in m, of a second aperture in front of the lens.
        distortion: a table with `radial`, the coefficients k1, k2, ... without unit, and the
            further fields of `Distortion`.
        diffraction: a table with `kind`, "Diffraction" or "Wavefront", and its fields, such as
            `wavelength` in m.
    """
    if aperture is not None and blades is not None:
        raise InputError("give either blades or aperture.")
    if blades is not None:
        aperture = PolygonalAperture(blades)
    return ThinLens(
        focal_length=focal_length,
        pixel_pitch=pixel_pitch,
        f_number=f_number,
        focus_distance=focus_distance,
        resolution=resolution,
        aperture=CircularAperture() if aperture is None else aperture,
        rim=rim,
        distortion=distortion,
        diffraction=diffraction,
        **placed,
    )


VIEWS: dict[str, Callable[..., View]] = {
    "orthographic": _orthographic,
    "pinhole": _pinhole,
    "thin_lens": _thin_lens,
}


# ---------------------------------------------------------------- tables


def light_keys(*, name: str | None = None) -> None:
    """Define the keys that every table `[[light]]` has, whatever its kind.

    Args:
        name: of the light in messages; by default its number.
    """


def light_tables() -> dict[str, Table]:
    """Return the tables of all registered lights, by the value of their key `kind`."""
    return _tables_by_word("lights", kinds())


def material_tables() -> dict[str, Table]:
    """Return the tables of all registered materials, by the value of their key `family`."""
    return _tables_by_word("materials", families())


def _tables_by_word(things: str, registered: Mapping[type, Any]) -> dict[str, Table]:
    """Return the tables of light or material types, by the word that names the type in a scene
    file. If a class is defined again, its new definition replaces the old one; two different
    classes may not have the same word."""
    found: dict[str, Table] = {}
    tables: list[Table | None] = [own.table for own in registered.values()]
    for table in tables:
        if table is not None:
            other = found.get(table.word, table)
            if _name_of(table.record) != _name_of(other.record):
                raise InputError(
                    f'Two {things} have the word "{table.word}" in scene files: '
                    f"{_name_of(other.record)} and {_name_of(table.record)}. Register one with "
                    "another `word`."
                )
            found[table.word] = table
    return found


def _name_of(record: type) -> str:
    return f"{record.__module__}.{record.__qualname__}"


def keys_of_kind(table: Table) -> dict[str, Key]:
    """Return the keys of a light or material, with `albedo` as an alternative to `diffuse`."""
    keys = keys_of(table.make, record=table.record)
    if "diffuse" not in keys or not issubclass(table.record, Material):
        return keys
    instead = {
        "diffuse": keys["diffuse"]._replace(
            default=None, about="k_d in sr^-1; give either `diffuse` or `albedo`."
        ),
        "albedo": Key(Colour | None, None, "pi k_d, at most 1, no unit."),
    }
    return instead | {name: key for name, key in keys.items() if name != "diffuse"}


def reading_of(file: str, bands: Bands, folder: Folder, quantity: Quantity) -> Reading:
    """Return the `Reading` of a scene file's tables, with spectra of one quantity."""

    def read_typed(hint: Any, where: str, value: Any) -> Any:
        if isinstance(value, Mapping) and {"map", "texels"} & set(value):
            return _map_of(reading, bands, folder, hint, where, value)
        if hint == Colour:
            spectrum = spectrum_of(reading, where, value)
            return band_values(spectrum, bands, folder, quantity=quantity)
        if hint == Photometry and is_dataclass(value):  # a lamp that a reader has tabulated
            return value
        if hint == Photometry:
            return read_luminaire(folder.file(value_of(reading, where, str, value)))
        if hint is Material and isinstance(value, Mapping):
            return material_of(reading, where, value)
        if hint == Picture and isinstance(value, np.ndarray):
            return value
        if hint in (Picture, Measured):
            name = value_of(reading, where, str, value)
            return (_picture if hint == Picture else _tabulate_measured)(folder, name, bands)
        return NotImplemented

    reading = Reading(file, "scene", finite=True, typed=read_typed)
    return reading


def _map_of(
    reading: Reading, bands: Bands, folder: Folder, hint: Any, where: str, value: Mapping[str, Any]
) -> Map:
    """Make the map for a key whose value, of the type `hint`, varies over the surface."""
    stands_for = "spectrum" if hint == Colour else "normal" if hint is Map else "number"
    texels = {name: own for name, own in value.items() if name == "texels"}
    rest = {name: own for name, own in value.items() if name != "texels"}
    values = values_of(reading, where, keys_of(make_map), rest)
    return make_map(stands_for, bands, folder, **texels, **values)


def light_of(reading: Reading, where: str, entry: Mapping[str, Any]) -> Light:
    """Make the light of a table `[[light]]`; `InputError` if the table is invalid."""
    word, rest = _word(reading, where, "kind", entry, light_tables())
    table = light_tables()[word]
    keys = keys_of(light_keys) | keys_of_kind(table)
    values = _values(reading, where, keys, rest)
    return table.make(**{name: value for name, value in values.items() if name != "name"})


def material_of(reading: Reading, where: str, entry: Mapping[str, Any]) -> Material:
    """Make the material of a table `[material.NAME]`; `InputError` if the table is invalid."""
    word, rest = _word(reading, where, "family", entry, material_tables())
    table = material_tables()[word]
    keys = keys_of_kind(table)
    values = _values(reading, where, keys, rest)
    if "albedo" in keys:
        albedo = values.pop("albedo", None)
        if ("diffuse" in values) + (albedo is not None) + ("body" in values) != 1:
            other = ", or a body" if "body" in keys else ""
            raise InputError(f"give either diffuse (sr^-1) or albedo (pi times it){other}.")
        if albedo is not None:
            largest = np.asarray(albedo).max()
            if largest > 1:
                raise InputError(
                    f"an albedo is at most 1, got {largest:.4g}: no surface reflects more than it "
                    "receives."
                )
            values["diffuse"] = (
                replace(albedo, values=albedo.values / np.pi)
                if isinstance(albedo, Map)
                else albedo / np.pi
            )
    return table.make(**values)


def surface_of(
    reading: Reading,
    where: str,
    entry: Mapping[str, Any],
    folder: Folder,
    dtype: str,
    *,
    mapped: Callable[[Any], bool],
) -> tuple[Shape, dict[str, Any]]:
    """Return the `Shape` that the table `[[surface]]` at `where` describes, and the values of its
    keys that do not belong to the shape.
    Texture coordinates of a mesh are read if its material is `mapped` or if the surface has a
    normal map. Raise `InputError` if the table is invalid."""
    word, rest = _word(reading, where, "shape", entry, SHAPES)
    make, beside = SHAPES[word], keys_of(surface_keys)
    values = _values(reading, where, beside | keys_of(make), rest)
    more = surface_keys(**{name: values.pop(name) for name in beside if name in values})
    if word == "mesh":
        wanted = mapped(more["material"]) or "normals" in more
        values |= {"file": folder.file(values["file"]), "dtype": dtype, "uv": wanted}
    elif word == "triangles":
        values["dtype"] = dtype
    shape = make(**values)
    if more.get("normals") is not None:
        name_doubtful_normals(where, shape, more["normals"])
    return shape, more


def view_of(reading: Reading, where: str, entry: Mapping[str, Any]) -> View:
    """Make the view of the table `[camera]`; `InputError` if the table is invalid."""
    word, rest = _word(reading, where, "kind", entry, VIEWS)
    make, beside = VIEWS[word], keys_of(camera_keys)
    values = _values(reading, where, beside | keys_of(make), rest)
    placed = camera_keys(**{name: values.pop(name) for name in beside if name in values})
    return make(**placed, **values)


def _word(
    reading: Reading, where: str, key: str, entry: Mapping[str, Any], known: Mapping[str, Any]
) -> tuple[str, dict[str, Any]]:
    """Return the word that names the type of a table, and the other keys of the table."""
    rest = dict(entry)
    if key not in rest:
        raise reading.wrong(f"{where}: {key} is missing; add it.")
    return chosen(reading, f"{where}: {key}", rest.pop(key), known), rest


def _values(
    reading: Reading, where: str, keys: Mapping[str, Key], entry: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the values of a table, including spectra that have a default."""
    usual = {
        name: key.default
        for name, key in keys.items()
        if key.default not in (None, MISSING) and Colour in members_of(key.hint)
    }
    return values_of(reading, where, keys, usual | dict(entry))


def _picture(folder: Folder, name: str, bands: Bands) -> np.ndarray:
    """Read a picture of the sky, (h, w, bands) W m^-2 sr^-1."""
    picture = read_environment(folder.file(name))
    if picture.shape[2] != bands.count:
        raise InputError(
            f"{folder.file(name)}: has {picture.shape[2]} bands where the scene has {bands.count}; "
            "convert one to the other."
        )
    return picture


def _tabulate_measured(folder: Folder, name: str, bands: Bands) -> Material:
    """Read a measured BRDF as a table in the bands of the scene."""
    file = folder.file(name)
    found = read_measured(file)
    table: Any = found if isinstance(found, Material) else table_of_samples(found)
    values = np.asarray(table.values)
    if table.wavelengths is not None:
        known = np.asarray(table.wavelengths)
        values = np.maximum(values @ reduction(known, bands, quantity="reflectance"), 0)
    elif bands.wavelengths is not None or values.shape[-1] != bands.count:
        raise InputError(
            f"{file}: holds RGB where the scene has {bands.count} bands of its own; render it in "
            "RGB, or take a spectral measurement."
        )
    return replace(table, values=values, wavelengths=bands.wavelengths)


def _checked_axes(rotation: np.ndarray | None) -> np.ndarray | None:
    if rotation is None:
        return None
    axes = np.asarray(rotation)
    if np.abs(axes @ axes.T - np.eye(3)).max() > 1e-3 or np.linalg.det(axes) < 0:
        raise InputError("rotation must hold three right-handed unit axes as rows; correct it.")
    exact, _, back = np.linalg.svd(axes)  # the nearest rotation: digits were rounded in the file
    return exact @ back
