"""Read scene files as records. A scene file is TOML with lights, surfaces, materials and a camera.
Scenes of Mitsuba, pbrt and glTF are read too; the packages `mitsuba`, `pbrt` and `gltf` list the
supported parts.

`tables` and `schema` define the contents of a scene file. Reading cannot be traced by JAX. Every
mistake in a file raises an `InputError` with a message of one sentence that names the file and the
object. Shipped scenes are read by their names instead of a path.
"""

import hashlib
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ...core._maps import maps_of
from ...core._types import as_dtype
from ...core._warnings import warn
from ...core.in_notebooks import record_html
from ...errors import InputError, nearest
from ...geometry.checks import coarse, coincident, invalid
from ...rendering.scene_checks import lost_numbers, scene_problems
from ...scene import AmbientLight, Material, Scene, Surface, TriangleMesh, View
from ..gltf import SUFFIXES as GLTF
from ..records import record_of
from ..shipped import existing_file, shipped_files
from ..toml import checked, read_toml
from .bands import bands_of
from .folder import Folder
from .schema import RenderEntry, SceneEntry, ineffective_keys
from .tables import light_of, material_of, reading_of, surface_of, view_of

_LOG = logging.getLogger("jaxvision.scene_files")


@dataclass(frozen=True)
class SceneFile:
    """The content of a scene file.

    Attributes:
        path: the file.
        scene: surfaces and lights.
        view: projection of the camera.
        render: settings of `[render]`.
        bands: number of bands.
        wavelengths: (bands,) m, or None; then three bands are RGB.
        surfaces: name of each surface in messages.
        lights: name of each light in messages.
        digest: a hash of all numbers of the scene and its view, independent of their files.

    Example:
        >>> file = jv.files.read_scene("glass_and_mirror")
        >>> print(file.path.name, file.bands, file.lights)
        glass_and_mirror.toml 3 ('light "lamp"', 'light "sky"')
    """

    path: Path
    scene: Scene
    view: View
    render: RenderEntry
    bands: int
    wavelengths: np.ndarray | None
    surfaces: tuple[str, ...]
    lights: tuple[str, ...]
    digest: str

    def __str__(self) -> str:
        counts = {"surface": len(self.surfaces), "light": len(self.lights), "band": self.bands}
        held = (f"{n} {kind}{'' if n == 1 else 's'}" for kind, n in counts.items())
        return f"{self.path.name}: {', '.join(held)}"

    def _repr_html_(self) -> str:
        """Return the HTML table of all surfaces and lights that a notebook shows."""
        surfaces = zip(self.surfaces, self.scene.surfaces, strict=True)
        rows = [(name, type(s.shape).__name__, type(s.material).__name__) for name, s in surfaces]
        lights = zip(self.lights, self.scene.lights, strict=True)
        rows += [(name, type(light).__name__, "") for name, light in lights]
        return record_html(("", "kind", "material"), rows, title=str(self))


def shipped_scenes() -> list[str]:
    """List the names of the scenes that come with the library.

    Returns:
        The names, sorted.

    Example:
        >>> print(jv.files.shipped_scenes())
        ['cornell_box', 'cornell_box_spectral', 'glass_and_mirror']
    """
    return list(shipped_files("scene"))


def read_scene(path: str | os.PathLike[str]) -> SceneFile:
    """Read and check a scene file, or a shipped scene given by its name.

    Args:
        path: the file, TOML, Mitsuba's XML, pbrt or glTF, or one of `shipped_scenes`.

    Returns:
        The scene and its render settings.

    Raises:
        InputError: for the first mistake in the file, or the first problem that `scene_checks`
            finds.

    Example:
        >>> file = jv.files.read_scene("cornell_box")
        >>> print(file)
        cornell_box.toml: 15 surfaces, 1 light, 3 bands
        >>> print(file.view.resolution, file.surfaces[:3])
        (512, 512) ('surface "floor"', 'surface "ceiling"', 'surface "back wall"')
    """
    file = existing_file(path, "scene")
    content = _content(file)
    entry = checked(file, content, SceneEntry, "scene")
    folder = Folder(file)
    with _named_messages(file, ""):
        bands = bands_of(entry.bands, entry.wavelengths)
    lit, painted = (
        reading_of(str(file), bands, folder, quantity) for quantity in ("light", "reflectance")
    )
    black = {"family": "lambert", "albedo": 0.0}
    materials: dict[str | None, Material] = {None: material_of(painted, "", black)}
    for name, made_of in entry.material.items():
        with _named_messages(file, f"material.{name}"):
            materials[name] = material_of(painted, f"material.{name}", made_of)
    names = _names("surface", entry.surface)
    surfaces = []
    for name, surface in zip(names, entry.surface, strict=True):
        with _named_messages(file, name):
            shape, more = surface_of(
                lit,
                name,
                surface,
                folder,
                entry.render.dtype,
                mapped=lambda word: any(True for _ in maps_of(materials.get(word))),
            )
            if (made_of := more.pop("material")) not in materials:
                hint = nearest(made_of, entry.material)
                raise InputError(f"material {made_of!r} is not in the file; {hint}.")
            surfaces.append(Surface(shape, materials[made_of], **more))
    lights, light_names = [], _names("light", entry.light)
    for name, light in zip(light_names, entry.light, strict=True):
        with _named_messages(file, name):
            lights.append(light_of(lit, name, light))
    with _named_messages(file, "camera"):
        view = view_of(lit, "camera", entry.camera)
    ambient = None
    if entry.ambient is not None:
        ambient = record_of(lit, "ambient", AmbientLight, entry.ambient)
    with _named_messages(file, ""):
        occluders = None if entry.render.shadows else ()
        scene = Scene(surfaces, lights, ambient, occluders=occluders)
    for problem in scene_problems(scene, view, names, light_names):
        raise InputError(f"{file}: {problem}")
    dtype = entry.render.dtype
    if dtype == "float64" and not jax.config.read("jax_enable_x64"):
        raise InputError(f"{file}: render.dtype = 'float64' needs JAX's jax_enable_x64; set it.")
    kept, kept_view = as_dtype((scene, view), dtype)
    _check_rounding(file, names, light_names, (scene, view), (kept, kept_view))
    for hidden in coincident([surface.shape for surface in scene.surfaces], names):
        warn(f"{file}: {hidden}")
    for idle in ineffective_keys(content, entry):
        warn(f"{file}: {idle}.")
    read = SceneFile(
        file,
        kept,
        kept_view,
        entry.render,
        bands.count,
        bands.wavelengths,
        names,
        light_names,
        _digest(kept, kept_view),
    )
    _LOG.info("read %s", read)
    return read


def _content(file: Path) -> dict[str, Any]:
    """Read the tables of a TOML file, or convert the scene of another program to such tables."""
    suffix = file.suffix.lower()
    if suffix not in (".xml", ".pbrt", *GLTF):
        return read_toml(file, "scene")
    from . import gltf, mitsuba, pbrt

    with _named_messages(file, ""):
        return {".xml": mitsuba, ".pbrt": pbrt}.get(suffix, gltf).scene_of(file)


def _digest(*records: object) -> str:
    leaves, structure = jax.tree.flatten(records)
    whole = hashlib.sha256(str(structure).encode())
    for leaf in map(np.asarray, leaves):
        whole.update(f"{leaf.dtype}{leaf.shape}".encode() + leaf.tobytes())
    return whole.hexdigest()


def _names(kind: str, entries) -> tuple[str, ...]:
    """Return the name of each entry in messages: its key `name`, or its position."""
    return tuple(
        f'{kind} "{entry["name"]}"' if isinstance(entry.get("name"), str) else f"{kind}[{i}]"
        for i, entry in enumerate(entries, 1)
    )


def _check_rounding(
    file: Path,
    surfaces: tuple[str, ...],
    lights: tuple[str, ...],
    exact: tuple[Scene, View],
    rounded: tuple[Scene, View],
) -> None:
    """Refuse objects that the rendering's dtype cannot hold; warn of coarse ones."""
    (scene, view), (kept, kept_view) = exact, rounded
    objects = [
        *zip(surfaces, scene.surfaces, kept.surfaces, strict=True),
        *zip(lights, scene.lights, kept.lights, strict=True),
        ("ambient", scene.ambient, kept.ambient),
        ("camera", view, kept_view),
    ]
    for name, before, after in objects:
        found = lost_numbers(before, after)
        if isinstance(after, Surface):
            found += invalid(after.shape)
        for problem in found:
            raise InputError(f"{file}: {name}: {problem}")
        if isinstance(after, Surface) and not isinstance(after.shape, TriangleMesh):
            for far in coarse(after.shape):  # for a mesh the reader has already warned
                warn(f"{file}: {name}: {far}")


@contextmanager
def _named_messages(file: Path, name: str) -> Iterator[None]:
    """Add the file and the object to the messages of errors and warnings in a `with` block."""
    where = f"{file}: {name}: " if name else f"{file}: "
    try:
        with warnings.catch_warnings(record=True) as caught:
            yield
    except ValueError as error:  # an InputError is one
        placed = str(error).startswith(f"{file}: ")
        raise InputError(str(error) if placed else where + str(error)) from error
    for warning in caught:
        warn(f"{where}{warning.message}", warning.category)
