"""Read and write RGL files (`.bsdf`): tensor files with one material, RGB or spectral.

The fields are theta_i (t,) and phi_i (p,) in rad, ndf and sigma (rows, columns), vndf (p, t, rows,
columns), luminance (p, t, n, n) and jacobian (1,). The colours are the field rgb (p, t, 3, n, n),
or the fields wavelengths (b,) in nm and spectra (p, t, b, n, n).

The file begins with "tensor_file", a zero byte, the version 1.0 in two bytes, and the number of
fields as a little-endian uint32. Each field has the length of its name as uint16, the name, the
number of dimensions as uint16, the type as uint8, the offset of its data from the start of the file
as uint64, and its shape as a uint64 for each dimension.

Source:
    Dupuy and Jakob 2018 and the loader published with the database, rgl.epfl.ch/materials.
"""

import math
import os
import struct
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...brdf.rgl import RGL, rgl_material
from ...errors import InputError
from ..images import as_float32, replaced_on_success
from ._contents import LEAST_NANOMETRES, NANOMETRE, TURN, contents_of, representable

_MAGIC = b"tensor_file\0"
_VERSION = b"\1\0"
_TYPES = dict(
    enumerate(("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"), 1)
)
_MOST_DIMENSIONS = 8  # the database's fields have 5 at most


def fields_in(file: Path, data: bytes) -> dict[str, np.ndarray]:
    """Read the named arrays of a tensor file."""
    cut = InputError(f"{file}: the file is cut short; copy it again from its source.")
    if len(data) < 14 and (_MAGIC.startswith(data) or data.startswith(_MAGIC)):
        raise cut
    if data[:12] != _MAGIC:
        raise InputError(f"{file}: not an RGL tensor file; take the .bsdf file of the database.")
    if data[12:14] != _VERSION:
        raise InputError(
            f"{file}: tensor file version {tuple(data[12:14])} where 1.0 is known; take the "
            "published version of the file."
        )
    position = 14

    def take(layout: str) -> tuple[int, ...]:
        nonlocal position
        size = struct.calcsize("<" + layout)
        if position + size > len(data):
            raise cut
        numbers = struct.unpack_from("<" + layout, data, position)
        position += size
        return numbers

    (count,) = take("I")
    if count > 1000:
        raise InputError(
            f"{file}: {count} fields are announced; the bytes are in big-endian order or the file "
            "is damaged, copy it again from its source."
        )
    found = {}
    for _ in range(count):
        (length,) = take("H")
        name = bytes(take(f"{length}B")).decode("utf-8", "replace")
        shown = name[:40]
        dimensions, kind, offset = take("HBQ")
        if dimensions > _MOST_DIMENSIONS:
            raise InputError(
                f"{file}: field {shown!r} announces {dimensions} dimensions; the header is "
                "damaged, copy the file again from its source."
            )
        shape = take(f"{dimensions}Q")
        if kind not in _TYPES:
            raise InputError(f"{file}: field {shown!r} has the unknown type {kind}; copy it again.")
        dtype = np.dtype(_TYPES[kind])
        size = dtype.itemsize * math.prod(shape)
        # an axis of length 0 must not hide an absurd length of another axis
        if offset + size > len(data) or math.prod(max(n, 1) for n in shape) > len(data):
            raise cut
        found[name] = np.frombuffer(data[offset : offset + size], dtype).reshape(shape)
    return found


def tensor_file(arrays: dict[str, np.ndarray]) -> bytes:
    """Return the bytes of a tensor file, with the headers of all fields before their data."""
    kinds = {np.dtype(name): number for number, name in _TYPES.items()}
    offset = len(_MAGIC + _VERSION) + 4
    offset += sum(2 + len(name.encode()) + 11 + 8 * x.ndim for name, x in arrays.items())
    head, body = _MAGIC + _VERSION + struct.pack("<I", len(arrays)), b""
    for name, x in arrays.items():
        head += struct.pack("<H", len(name.encode())) + name.encode()
        head += struct.pack("<HBQ", x.ndim, kinds[x.dtype], offset + len(body))
        head += struct.pack(f"<{x.ndim}Q", *x.shape)
        body += x.tobytes()
    return head + body


def read_rgl(path: str | os.PathLike[str]) -> RGL:
    """Read the RGB or spectral material of an RGL file.

    Args:
        path: the file.

    Returns:
        The material, with values in sr^-1, angles in rad and wavelengths in m.

    Raises:
        InputError: the file is missing or not of this format.
    """
    file, data = contents_of(path)
    fields = fields_in(file, data)
    spectral = "spectra" in fields
    colour = "spectra" if spectral else "rgb"
    needed = ["theta_i", "phi_i", "ndf", "sigma", "vndf", "luminance", "jacobian", colour]
    missing = [name for name in needed + ["wavelengths"] * spectral if name not in fields]
    if missing:
        raise InputError(
            f"{file}: no field {', '.join(missing)}; a tensor file, but not an RGL material."
        )
    nodes = (*fields["phi_i"].shape, *fields["theta_i"].shape)
    bands = fields["wavelengths"].size if spectral else 3
    square = fields["luminance"].shape[-2:]
    dimensions = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "luminance": 4}
    shapes = {"vndf": nodes, "luminance": nodes, colour: (*nodes, bands, *square), "jacobian": (1,)}
    dimensions |= {colour: 5, "jacobian": 1}
    for name in needed:
        shape, wanted = fields[name].shape, shapes.get(name, ())
        if len(shape) != dimensions[name] or shape[: len(wanted)] != wanted or 0 in shape:
            grid = f"{nodes[0]} azimuths and {nodes[1]} elevations of {bands} bands"
            raise _damage_error(file, name, f"has shape {shape}, which does not fit {grid}")
        if not representable(fields[name]).all():
            raise _damage_error(file, name, "holds values that are not finite")
    symmetry = _check_rgl_values(file, fields, spectral=spectral)
    dtype = jnp.result_type(float)
    table = {name: jnp.asarray(fields[name], dtype) for name in needed}
    return rgl_material(
        table["theta_i"],
        table["phi_i"],
        jnp.moveaxis(table[colour], 2, -1),
        table["ndf"],
        table["sigma"],
        table["vndf"],
        table["luminance"],
        wavelengths=jnp.asarray(fields["wavelengths"], dtype) * NANOMETRE if spectral else None,
        scaled=bool(fields["jacobian"][0]),
        symmetry=symmetry,
    )


def _check_rgl_values(file: Path, fields: dict[str, np.ndarray], *, spectral: bool) -> int:
    """Check that the values are in range, and return the number of equal sectors into which
    symmetry divides the azimuths."""
    theta, phi = fields["theta_i"], fields["phi_i"]
    for name in ("theta_i", "phi_i"):
        if (np.diff(fields[name]) <= 0).any():
            raise _damage_error(file, name, "does not increase")
    if theta[0] < 0 or theta[-1] > np.pi / 2 + 1e-4:
        raise InputError(
            f"{file}: field 'theta_i' runs from {theta[0]:g} to {theta[-1]:g}, which must lie in "
            "[0, pi / 2] rad; convert degrees to radians."
        )
    span = float(phi[-1] - phi[0])
    if np.abs(phi).max() > TURN or span > TURN:
        raise InputError(
            f"{file}: field 'phi_i' runs from {phi[0]:g} to {phi[-1]:g}, which must lie in "
            "[-2 pi, 2 pi] rad and span one turn at most; convert degrees to radians."
        )
    symmetry = 1 if len(phi) <= 2 else round(2 * np.pi / span)
    whole = len(phi) <= 2 or abs(span * symmetry / (2 * np.pi) - 1) < 1e-3
    if symmetry not in (1, 2, 4) or not whole:
        turn = "which is neither a turn nor a half nor a quarter of one"
        raise _damage_error(file, "phi_i", f"spans {span:g} rad, {turn}")
    for name in ("ndf", "sigma", "vndf", "luminance"):
        lowest = fields[name].min()
        if lowest < 0:
            raise _damage_error(file, name, f"holds {lowest:g} where nothing can be negative")
        if not fields[name].any():
            raise _damage_error(file, name, "is 0 everywhere")
    if spectral:
        nanometres = fields["wavelengths"]
        if not np.isfinite(nanometres).all() or (nanometres < LEAST_NANOMETRES).any():
            wanted = f"finite numbers, in nm, of {LEAST_NANOMETRES:g} or more"
            raise _damage_error(file, "wavelengths", f"must hold {wanted}")
    return symmetry


def _damage_error(file: Path, name: str, fault: str) -> InputError:
    """Return the error for a field whose values cannot come from the RGL database."""
    return InputError(f"{file}: field {name!r} {fault}; copy the file again.")


def write_rgl(path: str | os.PathLike[str], material: RGL, *, description: str = "") -> None:
    """Write a material as an RGL file, in float32 like the files of the database.

    Probability densities are normalised in the file. Readers normalise densities in any case.

    Args:
        path: the file.
        material: the material.
        description: text of the field `description`.
    """
    text = np.frombuffer(description.encode() or b"-", "u1")
    fields = {
        "description": text,
        "theta_i": material.theta,
        "phi_i": material.phi,
        "sigma": material.sigma,
        "ndf": material.ndf,
        "vndf": material.vndf.density,
        "luminance": material.luminance.density,
        "jacobian": np.array([material.scaled], "u1"),
    }
    values = np.moveaxis(np.asarray(material.values), -1, 2)
    if material.wavelengths is None:
        fields["rgb"] = values
    else:
        fields["wavelengths"] = np.asarray(material.wavelengths, np.float64) / NANOMETRE
        fields["spectra"] = values
    arrays = {
        name: np.asarray(x) if np.asarray(x).dtype == np.uint8 else as_float32(path, np.asarray(x))
        for name, x in fields.items()
    }
    with replaced_on_success(Path(path)) as partial:
        partial.write_bytes(tensor_file(arrays))
