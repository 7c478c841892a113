"""Photometric image formation as pure JAX functions: from light to digital numbers."""

from ._types import as_dtype
from ._vector import Vec, as_array, as_vec
from .brdf import reflect
from .brdf.gaussian_lobe import gaussian_lobe, gaussian_lobe_shading
from .brdf.lambert import lambert_shading
from .brdf.phong import phong_lobe, phong_shading
from .capture import Capture, capture, radiance_along, render
from .develop import develop, to_integers
from .errors import InputError
from .geometry import Hit, Ray, hit_shape, intersect, mirror_direction, nearest_shape
from .lights import Incident, incident
from .optics import camera_ray, look_at, sensor_irradiance
from .point_ops import gain_bias, gamma_decode, gamma_encode, srgb_decode, srgb_encode
from .scene import (
    SRGB,
    AmbientLight,
    Camera,
    Development,
    DirectionalLight,
    Gamma,
    GaussianLobe,
    GaussianShotNoise,
    Lambert,
    Orthographic,
    Phong,
    PhotonConversion,
    Pinhole,
    Plane,
    PointLight,
    PoissonShotNoise,
    Scene,
    Sensor,
    Sphere,
    Surface,
)
from .sensor import (
    collect,
    digitise,
    expected_signal,
    mean_photoelectrons,
    pattern_variance,
    photon_rate,
    raw_image,
    signal_variance,
)
from .shading import outgoing_radiance

__version__ = "0.1.0"

__all__ = [
    "SRGB",
    "AmbientLight",
    "Camera",
    "Capture",
    "Development",
    "DirectionalLight",
    "Gamma",
    "GaussianLobe",
    "GaussianShotNoise",
    "Hit",
    "Incident",
    "InputError",
    "Lambert",
    "Orthographic",
    "Phong",
    "PhotonConversion",
    "Pinhole",
    "Plane",
    "PointLight",
    "PoissonShotNoise",
    "Ray",
    "Scene",
    "Sensor",
    "Sphere",
    "Surface",
    "Vec",
    "as_array",
    "as_dtype",
    "as_vec",
    "camera_ray",
    "capture",
    "collect",
    "develop",
    "digitise",
    "expected_signal",
    "gain_bias",
    "gamma_decode",
    "gamma_encode",
    "gaussian_lobe",
    "gaussian_lobe_shading",
    "hit_shape",
    "incident",
    "intersect",
    "lambert_shading",
    "look_at",
    "mean_photoelectrons",
    "mirror_direction",
    "nearest_shape",
    "outgoing_radiance",
    "pattern_variance",
    "phong_lobe",
    "phong_shading",
    "photon_rate",
    "radiance_along",
    "raw_image",
    "reflect",
    "render",
    "sensor_irradiance",
    "signal_variance",
    "srgb_decode",
    "srgb_encode",
    "to_integers",
]
