"""The materials of a scene file as records."""

import dataclasses

import numpy as np

from ..brdf.blinn import Blinn, BlinnBRDF, NormalisedBlinn
from ..brdf.fresnel import Conductor, Dielectric, Interface, Schlick
from ..brdf.gaussian_lobe import GaussianLobe, GaussianLobeBRDF
from ..brdf.glass import Glass
from ..brdf.half_difference import HalfDifferenceTable
from ..brdf.lambert import Lambert
from ..brdf.measured import BRDFSamples, tabulate_sampler
from ..brdf.mirror import Mirror
from ..brdf.oren_nayar import OrenNayar
from ..brdf.phong import NormalisedPhong, Phong, PhongBRDF
from ..brdf.torrance_sparrow import TorranceSparrow
from ..errors import InputError
from ..measured_files import read_measured, table_of_samples
from ..scene import Material
from . import material_schema as schema
from .bands import Bands, in_bands, reduction
from .folder import Folder
from .spectrum_schema import Spectrum

_LOBES = {
    "phong": Phong,
    "phong_brdf": PhongBRDF,
    "normalised_phong": NormalisedPhong,
    "blinn": Blinn,
    "blinn_brdf": BlinnBRDF,
    "normalised_blinn": NormalisedBlinn,
    "gaussian_lobe": GaussianLobe,
    "gaussian_lobe_brdf": GaussianLobeBRDF,
}


def material_of(entry: schema.Material, bands: Bands, folder: Folder) -> Material:
    """The record of a table `[material.NAME]`.

    Args:
        entry: the table.
        bands: the bands of the scene.
        folder: where the file's paths start.

    Returns:
        The material.

    Raises:
        InputError: a spectrum or a file that does not suit the scene.
    """

    def spectrum(value: Spectrum) -> np.ndarray:
        return in_bands(value, bands, folder, quantity="reflectance")

    def optional(value: Spectrum | None) -> np.ndarray | None:
        return None if value is None else spectrum(value)

    def diffuse(entry: schema.Diffuse) -> np.ndarray:
        if entry.diffuse is not None:
            return spectrum(entry.diffuse)
        assert entry.albedo is not None  # the schema takes one of both
        albedo = spectrum(entry.albedo)
        if albedo.max() > 1:
            raise InputError(f"an albedo is at most 1, got {albedo.max():.4g}; scale it down.")
        return albedo / np.pi

    match entry:
        case schema.LambertEntry():
            return Lambert(diffuse(entry), ambient=optional(entry.ambient))
        case schema.OrenNayarEntry():
            return OrenNayar(
                diffuse(entry),
                np.radians(entry.sigma),
                ambient=optional(entry.ambient),
                form=entry.form,
            )
        case schema.PowerLobeEntry():
            k_d, k_s, k_a = diffuse(entry), spectrum(entry.specular), optional(entry.ambient)
            return _LOBES[entry.family](k_d, k_s, entry.exponent, ambient=k_a)
        case schema.GaussianLobeEntry():
            k_d, k_s, k_a = diffuse(entry), spectrum(entry.specular), optional(entry.ambient)
            return _LOBES[entry.family](k_d, k_s, entry.concentration, ambient=k_a)
        case schema.TorranceSparrowEntry():
            return TorranceSparrow(
                diffuse(entry),
                spectrum(entry.specular),
                entry.roughness,
                interface=_interface(*(optional(x) for x in (entry.eta, entry.k, entry.f0))),
                ambient=optional(entry.ambient),
                distribution=entry.distribution,
                shadowing=entry.shadowing,
            )
        case schema.MirrorEntry():
            return Mirror(spectrum(entry.reflectance))
        case schema.GlassEntry():
            return Glass(entry.index, absorption=optional(entry.absorption))
        case schema.MeasuredEntry():
            return _measured(entry.file, bands, folder)


def _interface(
    eta: np.ndarray | None, k: np.ndarray | None, f0: np.ndarray | None
) -> Interface | None:
    if f0 is not None:
        return Schlick(f0)
    if eta is None:
        return None
    return Dielectric(eta) if k is None else Conductor(eta, k)


def _measured(name: str, bands: Bands, folder: Folder) -> Material:
    """The table of a file in the bands of the scene, with a sampler for its own lobes."""
    file = folder.file(name)
    found = read_measured(file)
    table = table_of_samples(found) if isinstance(found, BRDFSamples) else found
    values = np.asarray(table.values)
    if table.wavelengths is not None:
        known = np.asarray(table.wavelengths)
        values = np.maximum(values @ reduction(known, bands, quantity="reflectance"), 0)
    elif bands.wavelengths is not None or values.shape[-1] != bands.count:
        raise InputError(
            f"{file}: holds RGB where the scene has {bands.count} bands of its own; render it in "
            "RGB, or take a spectral measurement."
        )
    table = dataclasses.replace(table, values=values, wavelengths=bands.wavelengths)
    return tabulate_sampler(table) if isinstance(table, HalfDifferenceTable) else table
