"""Files of measured reflectance: MERL, Cornell goniometer, RGL. The edge of the library: eager.

MERL (`.binary`): three little-endian int32 n_h, n_d, n_p (90, 90, 180), then as many float64 for
red, for green, for blue, phi_d fastest and theta_h slowest, over the bins of
`brdf.half_difference`. Values times (1, 1.15, 1.66) / 1500 are f_r in sr^-1. Negative values mark
bins that were not measured or lie below the surface. Source: the reader published with Matusik et
al., "A Data-Driven Reflectance Model", 2003.

Cornell (`.brdf`): text; `#` starts a comment. The number of wavelengths n, the n wavelengths in
nm, then one row per sample: theta_i phi_i theta_s phi_s in rad and n values of f_r in sr^-1. The
mirror direction lies at phi_s = phi_i + pi. Source: Cornell Program of Computer Graphics.

RGL (`.bsdf`): "tensor_file", a zero byte, version 1.0 in two bytes, a little-endian uint32 count
of fields; for each a uint16 length and the name, uint16 number of dimensions, uint8 type, uint64
offset from the file's start and uint64 per dimension. Fields: theta_i (t,), phi_i (p,) in rad,
ndf, sigma (rows, columns), vndf (p, t, rows, columns), luminance (p, t, n, n), jacobian (1,), and
rgb (p, t, 3, n, n) or wavelengths (b,) in nm with spectra (p, t, b, n, n). Source: Dupuy & Jakob
2018 and the loader published with the database, rgl.epfl.ch/materials.

Every failure is an `InputError` of one sentence that names the file.
"""

import math
import os
import struct
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from .brdf.half_difference import HalfDifferenceTable, bin_angles, half_difference
from .brdf.measured import BRDFSamples, sample_directions
from .brdf.rgl import RGL, rgl_material
from .errors import InputError
from .io import replaced_on_success

NANOMETRE = 1e-9


def _contents(path: str | os.PathLike[str]) -> tuple[Path, bytes]:
    file = Path(path)
    if file.is_dir():
        raise InputError(f"{file}: is a folder; name the file in it.")
    if not file.is_file():
        raise InputError(f"{file}: no such file; check the name and the folder.")
    return file, file.read_bytes()


def read_measured(path: str | os.PathLike[str]) -> HalfDifferenceTable | BRDFSamples | RGL:
    """What a file of measured reflectance holds, its format taken from the suffix: `.binary`
    (MERL), `.brdf` (Cornell) or `.bsdf` (RGL)."""
    readers = {".binary": read_merl, ".brdf": read_cornell, ".bsdf": read_rgl}
    suffix = Path(path).suffix.lower()
    if suffix not in readers:
        raise InputError(
            f"{path}: the suffix {suffix!r} is none of {', '.join(readers)}; rename the file to "
            "that of its format (MERL, Cornell, RGL)."
        )
    return readers[suffix](path)


# ---------------------------------------------------------------- MERL

MERL_SCALE = np.array([1.0, 1.15, 1.66]) / 1500


def _nearest_valid(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """(bins..., bands) with every invalid bin replaced by the nearest valid one, counted in bins,
    around the circle of phi_d."""
    from scipy.ndimage import distance_transform_edt

    turn = valid.shape[2]
    tiled = np.concatenate([valid] * 3, axis=2)
    middle = np.s_[:, :, turn : 2 * turn]
    nearest = distance_transform_edt(~tiled, return_distances=False, return_indices=True)
    h, d, p = (index[middle] for index in np.asarray(nearest))
    return values[h, d, p % turn]


def read_merl(
    path: str | os.PathLike[str], *, invalid: Literal["nearest", "zero"] = "nearest"
) -> HalfDifferenceTable:
    """The table of a MERL file, f_r in sr^-1.

    Bins that are marked as not measured take the value of the nearest measured bin, so that the
    interpolation at the edge of the measured range is not drawn to 0, or 0 (`invalid`).
    """
    file, data = _contents(path)
    if len(data) < 12:
        raise InputError(f"{file}: too short for a MERL file; copy it again from its source.")
    shape = struct.unpack("<3i", data[:12])
    swapped = struct.unpack(">3i", data[:12])
    if not all(0 < n <= 4096 for n in shape):
        if all(0 < n <= 4096 for n in swapped):
            raise InputError(
                f"{file}: the bytes are in big-endian order; swap them to the little-endian order "
                "of the MERL database."
            )
        raise InputError(
            f"{file}: the header gives {shape} bins, which is no MERL file; take the .binary file "
            "of the MERL database."
        )
    expected = 12 + 3 * 8 * int(np.prod(shape))
    if len(data) != expected:
        raise InputError(
            f"{file}: {len(data)} bytes where {shape} bins of three colours need {expected}; the "
            "file is cut short or damaged, copy it again from its source."
        )
    stored = np.frombuffer(data, "<f8", offset=12).reshape(3, *shape)
    if not np.isfinite(stored).all():
        raise InputError(
            f"{file}: {np.count_nonzero(~np.isfinite(stored))} values are not finite numbers; the "
            "file is damaged, copy it again from its source."
        )
    valid = np.asarray((stored >= 0).all(axis=0))
    if not valid.any():
        raise InputError(f"{file}: every bin is marked as not measured; take another file.")
    values = np.moveaxis(stored, 0, -1) * MERL_SCALE
    if invalid == "nearest" and not valid.all():
        values = _nearest_valid(values, valid)
    else:
        values = np.where(valid[..., None], values, 0)
    return HalfDifferenceTable(jnp.asarray(values))


def write_merl(path: str | os.PathLike[str], table: HalfDifferenceTable) -> None:
    """Writes a table of three bands as a MERL file; no bin is marked as not measured."""
    *shape, bands = table.values.shape
    if bands != 3:
        raise InputError(f"{path}: a MERL file holds 3 bands, got {bands}; convert to RGB first.")
    stored = np.moveaxis(np.asarray(table.values, np.float64) / MERL_SCALE, -1, 0)
    with replaced_on_success(Path(path)) as partial:
        partial.write_bytes(struct.pack("<3i", *shape) + stored.astype("<f8").tobytes())


# ---------------------------------------------------------------- Cornell

_TURN = 6.2832  # rad, 2 pi rounded up to the digits that files hold


def read_cornell(path: str | os.PathLike[str]) -> BRDFSamples:
    """The samples of a Cornell goniometer file, in the file's order."""
    file, data = _contents(path)
    try:
        lines = data.decode("ascii").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(
            f"{file}: not a text file (byte {error.start}); Cornell files are plain numbers."
        ) from None
    rows: list[tuple[int, list[float]]] = []
    for number, line in enumerate(lines, 1):
        words = line.split("#")[0].split()
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            raise InputError(
                f"{file}, line {number}: {' '.join(words)[:40]!r} is not a row of numbers; correct "
                "it or start it with #."
            ) from None
        if not np.isfinite(numbers).all():
            raise InputError(
                f"{file}, line {number}: a value is not a finite number; remove the row."
            )
        if numbers:
            rows.append((number, numbers))
    if not rows or len(rows[0][1]) != 1 or rows[0][1][0] % 1 or rows[0][1][0] < 1:
        raise InputError(
            f"{file}: the first number must be the count of wavelengths, alone on its line; this "
            "is no Cornell file."
        )
    bands, wavelengths = int(rows.pop(0)[1][0]), []
    while rows and len(wavelengths) < bands:
        wavelengths += rows.pop(0)[1]
    if len(wavelengths) != bands or (np.diff(wavelengths) <= 0).any() or wavelengths[0] <= 0:
        raise InputError(
            f"{file}: {bands} increasing wavelengths in nm are announced, got {len(wavelengths)} "
            f"numbers starting {wavelengths[:4]}; correct the header."
        )
    if not rows:
        raise InputError(f"{file}: the header is followed by no samples; copy the file again.")
    for number, row in rows:
        if len(row) != 4 + bands:
            raise InputError(
                f"{file}, line {number}: {len(row)} columns where four angles and {bands} values "
                f"make {4 + bands}; the row is cut short or the header wrong."
            )
        if not (0 <= row[0] <= 1.5708 and 0 <= row[2] <= 1.5708):
            raise InputError(
                f"{file}, line {number}: elevations {row[0]:g} and {row[2]:g} must lie in "
                "[0, pi / 2] rad; convert degrees to radians."
            )
        if max(abs(row[1]), abs(row[3])) > _TURN:
            raise InputError(
                f"{file}, line {number}: azimuths {row[1]:g} and {row[3]:g} must lie in "
                "[-2 pi, 2 pi] rad; convert degrees to radians."
            )
    table = np.array([row for _, row in rows])
    theta_i, phi_i, theta_s, phi_s = jnp.asarray(table[:, :4].T)
    values, metres = jnp.asarray(table[:, 4:]), jnp.asarray(wavelengths) * NANOMETRE
    return BRDFSamples(theta_i, phi_i, theta_s, phi_s, values, metres)


def write_cornell(
    path: str | os.PathLike[str], samples: BRDFSamples, *, description: str = ""
) -> None:
    """Writes samples in the Cornell layout, 17 significant digits; they need wavelengths."""
    if samples.wavelengths is None:
        raise InputError(f"{path}: the Cornell layout needs wavelengths, which RGB has not.")
    angles = (samples.theta_i, samples.phi_i, samples.theta_o, samples.phi_o)
    table = np.column_stack([*map(np.asarray, angles), np.asarray(samples.values)])
    wavelengths = np.asarray(samples.wavelengths, np.float64) / NANOMETRE
    head = [f"# {line}" for line in description.splitlines()]
    head += ["# num wls", f"{len(wavelengths)}", "", "# wls"]
    head += [" ".join(f"{x:.12g}" for x in wavelengths), ""]
    head += ["# theta i, phi i, theta s, phi_s, spectral sample values", ""]
    rows = [" ".join(f"{x:.17g}" for x in row) for row in table]
    with replaced_on_success(Path(path)) as partial:
        partial.write_text("\n".join(head + rows) + "\n")


def table_of_samples(
    samples: BRDFSamples, *, shape: tuple[int, int, int] = (45, 30, 24), floor: float = 1e-3
) -> HalfDifferenceTable:
    """A continuous, reciprocal, mirror-symmetric BRDF through scattered isotropic samples.

    log(f_r + `floor`), floor in sr^-1, is interpolated by radial functions (kernel r) over half
    and difference angles, where narrow lobes stand still as `wi` moves, and tabulated in bins
    (n_h, n_d, n_p). On the Cornell paints, with one of eight angles of incidence left out, this
    errs 1.5 to 10 times less than linear interpolation over the angles of both directions.
    """
    from scipy.interpolate import RBFInterpolator

    def features(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
        # Straight near the normal, so that no spike is drawn there, logarithmic beyond a narrow
        # lobe. cos(2 phi_d) joins a pair of directions, the exchanged one and both mirror images;
        # it matters the less the nearer h is to the normal.
        x = 0.5 * np.arcsinh(theta_h / 0.1)
        return np.stack([x, theta_d, 0.25 * x * np.cos(2 * phi_d)], axis=-1)

    angles = jax.vmap(half_difference)(*sample_directions(samples))
    known = features(*(np.asarray(a) for a in (angles.theta_h, angles.theta_d, angles.phi_d)))
    values = np.log(np.maximum(np.asarray(samples.values, np.float64), 0) + floor)
    empty = HalfDifferenceTable(jnp.zeros((*shape, 1), samples.values.dtype))
    nodes = np.meshgrid(*map(np.asarray, bin_angles(empty)), indexing="ij")
    wanted = features(*nodes).reshape(-1, 3)
    interpolant = RBFInterpolator(known, values, kernel="linear", smoothing=1e-4)
    found = np.maximum(np.exp(interpolant(wanted)) - floor, 0).reshape(*shape, -1)
    return HalfDifferenceTable(
        jnp.asarray(found, samples.values.dtype), wavelengths=samples.wavelengths
    )


# ---------------------------------------------------------------- RGL

_MAGIC = b"tensor_file\0"
_VERSION = b"\1\0"
_TYPES = dict(
    enumerate(("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"), 1)
)
_MOST_DIMENSIONS = 8  # the database's fields have 5 at most


def _fields(file: Path, data: bytes) -> dict[str, np.ndarray]:
    """The named arrays of a tensor file."""
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
        dimensions, kind, offset = take("HBQ")
        if dimensions > _MOST_DIMENSIONS:
            raise InputError(
                f"{file}: field {name[:40]!r} announces {dimensions} dimensions; the header is "
                "damaged, copy the file again from its source."
            )
        shape = take(f"{dimensions}Q")
        if kind not in _TYPES:
            raise InputError(f"{file}: field {name!r} has the unknown type {kind}; copy it again.")
        dtype = np.dtype(_TYPES[kind])
        size = dtype.itemsize * math.prod(shape)
        # an axis of length 0 hides no absurd one
        if offset + size > len(data) or math.prod(max(n, 1) for n in shape) > len(data):
            raise cut
        found[name] = np.frombuffer(data[offset : offset + size], dtype).reshape(shape)
    return found


def read_rgl(path: str | os.PathLike[str]) -> RGL:
    """The material of an RGL file, RGB or spectral."""
    file, data = _contents(path)
    fields = _fields(file, data)
    spectral = "spectra" in fields
    colour = "spectra" if spectral else "rgb"
    needed = ["theta_i", "phi_i", "ndf", "sigma", "vndf", "luminance", "jacobian", colour]
    missing = [name for name in needed + ["wavelengths"] * spectral if name not in fields]
    if missing:
        raise InputError(
            f"{file}: no field {', '.join(missing)}; this is a tensor file, but no RGL material."
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
            raise InputError(
                f"{file}: field {name!r} has shape {shape}, which does not fit {nodes[0]} azimuths "
                f"and {nodes[1]} elevations of {bands} bands; copy the file again."
            )
        if not np.isfinite(fields[name]).all():
            raise InputError(
                f"{file}: field {name!r} holds values that are not finite; copy the file again."
            )
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
    """`InputError` for numbers that are no angles or no densities; how many equal sectors of
    azimuth a turn has."""
    theta, phi = fields["theta_i"], fields["phi_i"]
    for name in ("theta_i", "phi_i"):
        if (np.diff(fields[name]) <= 0).any():
            raise InputError(f"{file}: field {name!r} does not increase; copy the file again.")
    if theta[0] < 0 or theta[-1] > np.pi / 2 + 1e-4:
        raise InputError(
            f"{file}: field 'theta_i' runs from {theta[0]:g} to {theta[-1]:g}, which must lie in "
            "[0, pi / 2] rad; convert degrees to radians."
        )
    span = float(phi[-1] - phi[0])
    if np.abs(phi).max() > _TURN or span > _TURN:
        raise InputError(
            f"{file}: field 'phi_i' runs from {phi[0]:g} to {phi[-1]:g}, which must lie in "
            "[-2 pi, 2 pi] rad and span one turn at most; convert degrees to radians."
        )
    symmetry = 1 if len(phi) <= 2 else round(2 * np.pi / span)
    if symmetry not in (1, 2, 4):
        raise InputError(
            f"{file}: field 'phi_i' spans {span:g} rad, which is neither a turn nor a half nor a "
            "quarter of one; copy the file again."
        )
    for name in ("ndf", "sigma", "vndf", "luminance"):
        lowest = fields[name].min()
        if lowest < 0:
            raise InputError(
                f"{file}: field {name!r} holds {lowest:g} where nothing can be negative; copy the "
                "file again."
            )
        if not fields[name].any():
            raise InputError(f"{file}: field {name!r} is 0 everywhere; copy the file again.")
    if spectral:
        nanometres = fields["wavelengths"]
        if not np.isfinite(nanometres).all() or (nanometres <= 0).any():
            raise InputError(
                f"{file}: field 'wavelengths' must hold finite numbers above 0, in nm; copy the "
                "file again."
            )
    return symmetry


def write_rgl(path: str | os.PathLike[str], material: RGL, *, description: str = "") -> None:
    """Writes a material as an RGL file, float32 as all of the database; densities are written
    normalised, which every reader does itself."""
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
        name: np.asarray(x) if np.asarray(x).dtype == np.uint8 else np.asarray(x, "<f4")
        for name, x in fields.items()
    }
    offset = 18 + sum(2 + len(name) + 11 + 8 * x.ndim for name, x in arrays.items())
    head, body = _MAGIC + _VERSION + struct.pack("<I", len(arrays)), b""
    for name, x in arrays.items():
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack("<HBQ", x.ndim, 1 if x.dtype == np.uint8 else 10, offset + len(body))
        head += struct.pack(f"<{x.ndim}Q", *x.shape)
        body += x.tobytes()
    with replaced_on_success(Path(path)) as partial:
        partial.write_bytes(head + body)
