"""Measured BRDFs by NumPy only, for one pair of directions at a time, with files byte by byte."""

import struct

import numpy as np


def directions(rng, count, *, highest=np.pi / 2):
    """Return unit vectors (count, 3) above the surface, with polar angles up to `highest` rad."""
    z = rng.uniform(np.cos(highest), 1, count)
    phi = rng.uniform(-np.pi, np.pi, count)
    s = np.sqrt(1 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)


def rotated(v, axis, angle):
    """Rotate by Rodrigues' formula."""
    axis = np.asarray(axis, float)
    return (
        v * np.cos(angle)
        + np.cross(axis, v) * np.sin(angle)
        + axis * np.dot(axis, v) * (1 - np.cos(angle))
    )


def half_difference(wi, wo):
    """Return (theta_h, phi_h, theta_d, phi_d) by two rotations, as defined by Rusinkiewicz."""
    h = (wi + wo) / np.linalg.norm(wi + wo)
    theta_h, phi_h = np.arccos(min(h[2], 1)), np.arctan2(h[1], h[0])
    d = rotated(rotated(wi, [0, 0, 1], -phi_h), [0, 1, 0], -theta_h)
    return theta_h, phi_h, np.arccos(min(d[2], 1)), np.arctan2(d[1], d[0])


def merl_bin(angles, shape=(90, 90, 180)):
    """Return the indices computed by the reader published with the database."""
    theta_h, _, theta_d, phi_d = angles
    n_h, n_d, n_p = shape
    i = min(int(np.sqrt(theta_h / (np.pi / 2)) * n_h), n_h - 1)
    j = min(int(theta_d / (np.pi / 2) * n_d), n_d - 1)
    k = min(int((phi_d + np.pi if phi_d < 0 else phi_d) / np.pi * n_p), n_p - 1)
    return i, j, k


def merl_bytes(reflectance, shape=(90, 90, 180), *, order="<"):
    """Return a MERL file of reflectance(theta_h, theta_d, phi_d) -> (..., 3) in sr^-1 at the
    centres of the bins. Bins with a direction below the surface are marked by -1."""
    n_h, n_d, n_p = shape
    theta_h = ((np.arange(n_h) + 0.5) / n_h) ** 2 * np.pi / 2
    theta_d = (np.arange(n_d) + 0.5) / n_d * np.pi / 2
    phi_d = (np.arange(n_p) + 0.5) / n_p * np.pi
    h, d, p = np.meshgrid(theta_h, theta_d, phi_d, indexing="ij")
    # z of the difference vector, and of its mirror image about h, after rotating h back by theta_h
    along, across = np.cos(d) * np.cos(h), np.sin(d) * np.cos(p) * np.sin(h)
    below = (along - across <= 0) | (along + across <= 0)
    stored = np.moveaxis(reflectance(h, d, p), -1, 0) * np.array(
        [1500, 1500 / 1.15, 1500 / 1.66]
    ).reshape(3, 1, 1, 1)
    stored = np.where(below, -1, stored)
    return struct.pack(f"{order}3i", *shape) + stored.astype(f"{order}f8").tobytes(), ~below


def tensor_bytes(fields):
    """Return a tensor file in the layout of `measured_files._tensor_file`, with data after all
    headers."""
    kinds = {"uint8": 1, "float32": 10, "float64": 11}
    arrays = {name: np.ascontiguousarray(x) for name, x in fields.items()}
    start = 14 + 4 + sum(2 + len(n) + 2 + 1 + 8 + 8 * x.ndim for n, x in arrays.items())
    heads, data = b"", b""
    for name, x in arrays.items():
        heads += struct.pack("<H", len(name)) + name.encode() + struct.pack("<H", x.ndim)
        heads += struct.pack("<BQ", kinds[x.dtype.name], start + len(data))
        heads += b"".join(struct.pack("<Q", n) for n in x.shape)
        data += x.tobytes()
    return b"tensor_file\x00" + bytes([1, 0]) + struct.pack("<I", len(arrays)) + heads + data


def rgl_fields(rng, *, phi=(0.0,), thetas=4, side=5, fine=25, bands=None):
    """Return random tables in the form of an RGL file, with visible normals within about 50 degrees
    of the surface normal, and spectral for given wavelengths `bands`."""
    phi = np.asarray(phi, np.float32)
    x = np.linspace(0, 1, fine, dtype=np.float32)
    narrow = np.exp(-((x / np.float32(0.4)) ** 4))
    nodes = (len(phi), thetas)

    def smooth(*shape):
        return rng.uniform(0.5, 2, shape).astype(np.float32)

    def turning(*shape):
        table = smooth(*shape)
        table[..., -1, :] = table[..., 0, :]  # azimuths -pi and pi are equal
        return table

    fields = {
        "description": np.frombuffer(b"made up", np.uint8),
        "phi_i": phi,
        "theta_i": (np.pi / 2 * np.linspace(0, 1, thetas) ** 1.1).astype(np.float32),
        "sigma": smooth(3, fine),
        "ndf": turning(3, fine) * narrow,
        "vndf": turning(*nodes, fine, fine) * x**3 * narrow,
        "luminance": smooth(*nodes, side, side),
        "jacobian": np.array([1], np.uint8),
    }
    if bands is None:
        return fields | {"rgb": smooth(*nodes, 3, side, side)}
    return fields | {
        "wavelengths": np.linspace(400, 700, bands, dtype=np.float32),
        "spectra": smooth(*nodes, bands, side, side),
    }


def _at(nodes, x):
    """Return indices and weight of linear interpolation, clamped."""
    if len(nodes) == 1:
        return 0, 0, 0.0
    i = int(np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2))
    return i, i + 1, float(np.clip((x - nodes[i]) / (nodes[i + 1] - nodes[i]), 0, 1))


def _slice(table, fields, phi, theta):
    """Return the table (p, t, ...) at a direction."""
    p0, p1, wp = _at(fields["phi_i"].astype(float), phi)
    t0, t1, wt = _at(fields["theta_i"].astype(float), theta)
    table = table.astype(float)
    return (1 - wp) * ((1 - wt) * table[p0, t0] + wt * table[p0, t1]) + wp * (
        (1 - wt) * table[p1, t0] + wt * table[p1, t1]
    )


def _bilinear(table, x, y):
    """Interpolate a table (rows, columns) over the unit square."""
    rows, columns = table.shape
    profile = [np.interp(x * (columns - 1), np.arange(columns), row) for row in table]
    return np.interp(y * (rows - 1), np.arange(rows), profile)


def _integral_to(values, x):
    """Return the integral over [0, x] of the linear interpolant of values on [0, 1]."""
    nodes = np.linspace(0, 1, len(values))
    points = np.append(nodes[nodes < x], x)
    return np.trapezoid(np.interp(points, nodes, values), points)


def normalised(table):
    """Return slices (..., rows, columns) with an integral of 1 over the unit square."""
    table = table.astype(float)
    nodes = [np.linspace(0, 1, n) for n in table.shape[-2:]]
    total = np.trapezoid(np.trapezoid(table, nodes[1]), nodes[0])
    return table / total[..., None, None]


def rgl_shading(fields, wi, wo):
    """Return f_r cos(theta_i) as defined by Dupuy and Jakob, for an isotropic material or one whose
    phi_i spans a full turn, and the density of their sampler."""
    theta, phi = np.arccos(wo[2]), np.arctan2(wo[1], wo[0])
    h = (wi + wo) / np.linalg.norm(wi + wo)
    theta_h, phi_h = np.arccos(h[2]), np.arctan2(h[1], h[0])
    if len(fields["phi_i"]) <= 2:
        phi_h = phi_h - phi
    x, y = np.sqrt(theta_h * 2 / np.pi), (phi_h + np.pi) / (2 * np.pi) % 1
    visible = _slice(normalised(fields["vndf"]), fields, phi, theta)
    row_integrals = np.trapezoid(visible, np.linspace(0, 1, visible.shape[1]), axis=1)
    rows = np.arange(len(visible)) / (len(visible) - 1)
    profile = np.array([np.interp(y, rows, column) for column in visible.T])
    s = _integral_to(profile, x) / _integral_to(profile, 1.0), _integral_to(row_integrals, y)
    colour = "rgb" if "rgb" in fields else "spectra"
    values = [_bilinear(table, *s) for table in _slice(fields[colour], fields, phi, theta)]
    wo_place = np.sqrt(theta * 2 / np.pi), (phi + np.pi) / (2 * np.pi)
    scale = _bilinear(fields["ndf"], x, y) / (4 * _bilinear(fields["sigma"], *wo_place))
    luminance = _slice(normalised(fields["luminance"]), fields, phi, theta)
    jacobian = 2 * np.pi**2 * x * np.sin(theta_h) * 4 * np.dot(wo, h)
    density = _bilinear(visible, x, y) * _bilinear(luminance, *s) / jacobian
    return np.maximum(values, 0) * scale, density
