"""Read and write a material as a TOML file. The key `kind` is the name of the material's record
type, and the other keys are the fields of the record, such as

kind = "Phong"
diffuse = [0.3]
specular = [0.4]
exponent = 25.0
"""

import os
from pathlib import Path

import jax
import numpy as np

from ..brdf import families
from ..errors import InputError, nearest
from ..scene import Material
from .records import Reading, attach_draws, record_of, table_of, write_record


def read_material(file: str | os.PathLike[str], *, draws: int | None = None) -> Material:
    """Read a material from a TOML file.

    Args:
        file: a file written by `write_material`.
        draws: number of draws of a fitted material, which are stored in a second file next to it;
            None for the best fit.

    Returns:
        The material; with draws, every number of it has a leading axis, for `jax.vmap`.

    Raises:
        InputError: for a missing file, an unknown key or a value out of range, NaN included.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/matte.toml"
        >>> jv.write_material(jv.Lambert([0.25]), file)
        >>> jv.read_material(file)
        Lambert(diffuse=[0.25])
    """
    from .toml import read_toml

    path = Path(file)
    table = read_toml(path, "material")
    name = str(table.pop("kind", ""))
    kinds = {kind.__name__: kind for kind in families()}
    if name not in kinds:
        raise InputError(f"{path}: kind = {name!r} is no material; {nearest(name, kinds)}.")
    material = record_of(Reading(str(path), "material"), "", kinds[name], table)
    for place, number in jax.tree.leaves_with_path(material):
        if not np.isfinite(number).all():
            where = jax.tree_util.keystr(place, simple=True, separator=".")
            raise InputError(f"{path}: {where} must hold finite numbers; correct it.")
    return material if draws is None else attach_draws(path, material, draws)


def write_material(
    material: Material, file: str | os.PathLike[str], *, draws: Material | None = None
) -> None:
    """Write a material to a TOML file; `read_material` reads it back with exactly the same numbers.

    Args:
        material: the material to write, for example the best fit.
        file: path of the file, ending in .toml; missing folders are created.
        draws: the same material with a leading axis of draws at every number; they are written to a
            file beside it, ending in .npz.

    Raises:
        InputError: for draws of another material, and a file name with another ending.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/matte.toml"
        >>> jv.write_material(jv.Lambert(diffuse=(0.3,)), file)
        >>> jv.read_material(file).diffuse.shape
        (1,)
    """
    write_record(file, "material", table_of(material), material, draws)
