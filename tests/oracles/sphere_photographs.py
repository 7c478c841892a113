"""Photographs of a sphere under distant lights, in plain NumPy and independent of the library:
textbook shading with arccos, then electrons, gain and rounding."""

import numpy as np

from jaxvision.files.images import write_image

from . import brdfs

INDEX = 1.5  # of refraction, of clear facets


def light_directions(count, *, widest=60.0, seed=0):
    """Return unit vectors toward lights within `widest` degrees of the view."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(np.cos(np.radians(widest)), 1, count)
    azimuth = rng.uniform(0, 2 * np.pi, count)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def sphere_normals(size, radius):
    """Return normals (size, size, 3) of a centred sphere, NaN outside its outline."""
    middle = (size - 1) / 2
    row, column = np.mgrid[0:size, 0:size]
    x, y = (column - middle) / radius, (middle - row) / radius
    with np.errstate(invalid="ignore"):
        z = np.sqrt(1 - x**2 - y**2)
    return np.where(np.isnan(z)[..., None], np.nan, np.stack([x, y, z], axis=-1))


def shade(normals, directions, model, diffuse, specular, shape):
    """Return k_d n.l + k_s lobe, (lights, h, w), where lit, and 0 elsewhere and outside the
    sphere."""
    n_l = np.einsum("hwc,lc->lhw", normals, directions)
    mirrored_z = 2 * n_l * normals[..., 2] - directions[:, None, None, 2]
    angle = np.arccos(np.clip(mirrored_z, -1, 1))
    if model not in ("lambert", "phong", "gaussian-lobe", "blinn"):
        return np.nan_to_num(
            _shade_pixels(normals, directions, n_l, model, diffuse, specular, shape)
        )
    half = directions + np.array([0, 0, 1])
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    lobe = {
        "blinn": lambda: np.maximum(np.einsum("hwc,lc->lhw", normals, half), 0) ** shape,
        "lambert": lambda: 0 * angle,
        "phong": lambda: np.maximum(mirrored_z, 0) ** shape,
        "gaussian-lobe": lambda: np.exp(-((shape * angle) ** 2)),
    }[model]()
    return np.nan_to_num(np.where(n_l > 0, diffuse * n_l + specular * lobe, 0))


def _shade_pixels(normals, directions, n_l, model, diffuse, specular, shape):
    """Return f_r cos(theta_i) by `oracles.brdfs`, pixel by pixel, each rotated so that its normal
    is +z."""
    k = {"kd": diffuse, "ks": specular}
    facets = {"alpha": (shape, shape), **k}
    reflect = {
        "normalised-phong": lambda i, o: brdfs.phong(i, o, n=shape, kind="normalised", **k),
        "normalised-blinn": lambda i, o: brdfs.blinn(i, o, n=shape, kind="normalised", **k),
        "oren-nayar": lambda i, o: brdfs.oren_nayar(i, o, kd=diffuse, sigma=shape, full=False),
        "eon": lambda i, o: np.pi * diffuse * brdfs.eon(i, o, kd=1 / np.pi, r=shape),
        "torrance-sparrow-beckmann": lambda i, o: brdfs.torrance_sparrow(
            i, o, eta=[INDEX], k=[0.0], distribution="beckmann", **facets
        ),
        "torrance-sparrow": lambda i, o: brdfs.torrance_sparrow(
            i, o, eta=[INDEX], k=[0.0], **facets
        ),
        "torrance-sparrow-metal": lambda i, o: brdfs.torrance_sparrow(i, o, **facets),
    }[model]
    shaded = np.zeros_like(n_l)
    for light, row, column in np.argwhere(n_l > 0):
        normal = normals[row, column]
        aside = np.cross(normal, [0.6, 0.64, 0.48])
        turned = np.stack([aside, np.cross(normal, aside)])
        turned = np.vstack([turned / np.linalg.norm(aside), normal])
        local = turned @ directions[light], turned @ [0.0, 0.0, 1.0]
        shaded[light, row, column] = np.squeeze(reflect(*local)) * local[0][2]
    return shaded


def shade_areas(size, radius, directions, *surface, parts=4):
    """Return means of `shade` over parts x parts points in each pixel, (lights, size, size)."""
    shaded = shade(sphere_normals(parts * size, parts * radius), directions, *surface)
    return shaded.reshape(-1, size, parts, size, parts).mean(axis=(2, 4))


def expose(rng, signal, *, gain, read_noise, black, clip):
    """Return digital numbers of a linear signal (DN): Poisson electrons, read noise, rounding,
    clipping."""
    electrons = rng.poisson(signal / gain) + read_noise * rng.standard_normal(signal.shape)
    return np.clip(np.round(black + gain * electrons), 0, clip)


def write_rig(folder, frames, directions, intensity, *, radius, camera, held_out=None, extra=""):
    """Write a folder of 16-bit PNGs with its rig.toml, for frames (lights, h, w[, 3])."""
    size = frames.shape[1]
    middle = (size - 1) / 2
    lines = ["[camera]", *(f"{key} = {value}" for key, value in camera.items())]
    lines += [f"[geometry]\nsphere = {{ centre = [{middle}, {middle}], radius = {radius} }}", extra]
    for i, frame in enumerate(frames):
        write_image(folder / f"{i:02d}.png", frame.astype(np.uint16))
        lines += [
            f'[[light]]\nfile = "{i:02d}.png"',
            f"direction = {[float(x) for x in directions[i]]}",
            f"intensity = {intensity}",
        ]
        if held_out is not None:
            lines.append(f"held_out = {str(bool(held_out[i])).lower()}")
    (folder / "rig.toml").write_text("\n".join(lines))
    return folder
