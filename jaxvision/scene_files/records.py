"""The surfaces, lights and camera of a scene file as records."""

from dataclasses import replace
from typing import assert_never

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..io import read_environment
from ..lights import (
    DirectionalLight,
    PointLight,
    RectangleLight,
    SmallLight,
    environment_map,
)
from ..mesh_files import read_mesh
from ..optics import look_at, opencv_view
from ..scene import (
    Box,
    CircularAperture,
    Disc,
    Light,
    Orthographic,
    Pinhole,
    Plane,
    PolygonalAperture,
    Quad,
    Shape,
    Sphere,
    ThinLens,
    View,
)
from . import camera_schema, light_schema, surface_schema
from .bands import Bands, in_bands
from .folder import Folder
from .spectrum_schema import Axes, Spectrum


def shape_of(entry: surface_schema.Surface, folder: Folder, dtype: str) -> Shape:
    """The shape of a table `[[surface]]`.

    Args:
        entry: the table; lengths in m.
        folder: where the file's paths start.
        dtype: of the rendering, for meshes.

    Returns:
        The shape.

    Raises:
        InputError: a rotation or a mesh file that cannot be used.
    """
    match entry:
        case surface_schema.SphereEntry():
            return Sphere(entry.centre, entry.radius)
        case surface_schema.PlaneEntry():
            return Plane(entry.point, entry.normal)
        case surface_schema.DiscEntry():
            return Disc(entry.centre, entry.normal, entry.radius)
        case surface_schema.QuadEntry():
            return Quad(entry.corner, entry.edge_u, entry.edge_v)
        case surface_schema.BoxEntry():
            rotation = _checked_axes(entry.rotation)
            return Box(entry.centre, entry.half_extents, rotation=rotation)
        case surface_schema.MeshEntry():
            return read_mesh(
                folder.file(entry.file),
                scale=entry.scale,
                rotation=_checked_axes(entry.rotation),
                position=entry.position,
                matrix=entry.matrix,
                smooth=entry.smooth,
                flip=entry.flip,
                primitive=entry.primitive,
                dtype=dtype,
            )


def light_of(entry: light_schema.Light, bands: Bands, folder: Folder) -> Light:
    """The light of a table `[[light]]`.

    Args:
        entry: the table; lengths in m, radiance in W m^-2 sr^-1.
        bands: the bands of the scene.
        folder: where the file's paths start.

    Returns:
        The light.

    Raises:
        InputError: a spectrum, a direction or a picture that cannot be used.
    """

    def spectrum(value: Spectrum) -> np.ndarray:
        return in_bands(value, bands, folder, quantity="light")

    match entry:
        case light_schema.PointEntry():
            return PointLight(entry.position, spectrum(entry.intensity))
        case light_schema.SmallEntry():
            return SmallLight(entry.position, entry.normal, spectrum(entry.intensity))
        case light_schema.DirectionalEntry():
            return DirectionalLight(entry.direction, spectrum(entry.irradiance))
        case light_schema.RectangleEntry():
            radiance = spectrum(entry.radiance)
            return RectangleLight(entry.corner, entry.edge_u, entry.edge_v, radiance)
        case light_schema.EnvironmentEntry():
            return environment_map(
                entry.scale * _sky(entry, bands, folder), rotation=_map_axes(entry)
            )
        case _:
            assert_never(entry)  # a kind of `light_schema` that has no record here


def view_of(entry: camera_schema.Camera) -> View:
    """The projection of the table `[camera]`.

    Args:
        entry: the table; lengths in m.

    Returns:
        The view.

    Raises:
        InputError: the direction of view is not defined.
    """
    position, rotation = np.asarray(entry.position), _camera_axes(entry)
    rows, columns = entry.resolution
    match entry:
        case camera_schema.OrthographicEntry():
            pitch = entry.width / columns
            return Orthographic(position, rotation, pitch, resolution=(rows, columns))
        case camera_schema.PinholeEntry():
            if entry.matrix is not None:
                view = opencv_view(
                    np.asarray(entry.matrix),
                    coefficients=entry.distortion or (),
                    resolution=(rows, columns),
                )
                return replace(view, position=jnp.asarray(position), rotation=jnp.asarray(rotation))
            focal_length, pitch = entry.focal_length, entry.pixel_pitch
            if entry.field_of_view is not None:  # the same picture at any focal length
                focal_length = 1.0
                pitch = 2 * np.tan(np.radians(entry.field_of_view) / 2) / columns
            return Pinhole(position, rotation, focal_length, pitch, resolution=(rows, columns))
        case camera_schema.ThinLensEntry():
            blades = entry.blades
            return ThinLens(
                position,
                rotation,
                entry.focal_length,
                entry.pixel_pitch,
                resolution=(rows, columns),
                f_number=entry.f_number,
                focus_distance=entry.focus_distance,
                aperture=CircularAperture() if blades is None else PolygonalAperture(blades),
            )


def _camera_axes(entry: camera_schema.Camera) -> np.ndarray:
    forward = np.subtract(entry.target, entry.position)
    if not forward.any():
        raise InputError("position and target are one point; move one of them.")
    if np.linalg.norm(np.cross(forward, entry.up)) <= 1e-9 * np.linalg.norm(forward):
        raise InputError("up lies along the line of sight; give another direction.")
    points = map(jnp.asarray, (entry.position, entry.target, entry.up))
    return np.asarray(jax.jit(look_at)(*points))  # one small program, not twenty


def _sky(entry: light_schema.EnvironmentEntry, bands: Bands, folder: Folder) -> np.ndarray:
    """(h, w, bands) W m^-2 sr^-1."""
    if entry.file is None:
        assert entry.radiance is not None  # the schema takes one of both
        radiance = in_bands(entry.radiance, bands, folder, quantity="light")
        return np.broadcast_to(radiance, (4, 8, bands.count))
    picture = read_environment(folder.file(entry.file))
    if picture.shape[2] != bands.count:
        raise InputError(
            f"{folder.file(entry.file)}: has {picture.shape[2]} bands where the scene has "
            f"{bands.count}; convert one to the other."
        )
    return picture


def _map_axes(entry: light_schema.EnvironmentEntry) -> np.ndarray:
    """Rows: the directions of the picture's middle column, of its left quarter and of its top."""
    up, toward = np.asarray(entry.up), np.asarray(entry.toward)
    left = np.cross(up, toward)
    if np.linalg.norm(left) <= 1e-9:
        raise InputError("up and toward lie on one line; give another toward.")
    axes = np.stack([np.cross(left, up), left, up])
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _checked_axes(rotation: Axes | None) -> np.ndarray | None:
    if rotation is None:
        return None
    axes = np.asarray(rotation)
    if np.abs(axes @ axes.T - np.eye(3)).max() > 1e-3 or np.linalg.det(axes) < 0:
        raise InputError("rotation must hold three right-handed unit axes as rows; correct it.")
    exact, _, back = np.linalg.svd(axes)  # the nearest rotation: digits were rounded in the file
    return exact @ back
