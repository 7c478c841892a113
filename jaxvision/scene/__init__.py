"""The records of a scene and a camera: light, surfaces, views, sensors, development.

Records hold numbers and have no behaviour. Every record is a frozen pytree. Non-static leaves are
arrays that keep the caller's floating dtype; an effect that is absent is `None` and is never
traced. Only shapes, kinds and choices of algorithm are static, so a sweep over exposure, gain or
bit depth compiles once. SI units throughout; world axes are right-handed. The shapes in the
docstrings are those of one record: a batch is a record whose leaves are stacked along a leading
axis, for `vmap`. A wrong shape raises `ValueError`.
"""

from .camera import Camera
from .developments import (
    JPEG,
    SRGB,
    Bilateral,
    Demosaicing,
    Denoising,
    Development,
    Filmic,
    Gamma,
    GreyWorld,
    NeutralPatch,
    NonLocalMeans,
    Reinhard,
    ToneCurve,
    ToneEncoding,
    ToneMap,
    UnsharpMask,
    WhiteBalance,
    WhiteBalancing,
)
from .lenses import (
    AnnularAperture,
    Aperture,
    CircularAperture,
    Diffraction,
    Distortion,
    PolygonalAperture,
    RectangularAperture,
    Rim,
)
from .light import AmbientLight, Light
from .noises import (
    ArrheniusDarkCurrent,
    Banding,
    DarkCurrent,
    DoublingDarkCurrent,
    FastPoissonShotNoise,
    GaussianShotNoise,
    HeavyTailedReadNoise,
    HotPixels,
    PoissonShotNoise,
    ResetNoise,
    ShotNoise,
    TelegraphNoise,
)
from .sensors import (
    ChargeTransfer,
    ColourFilter,
    PhotonConversion,
    PixelAperture,
    RollingShutter,
    Sensor,
)
from .shapes import Box, Disc, Plane, Quad, Shape, Sphere, TriangleMesh
from .surfaces import Material, Scene, Surface
from .views import Orthographic, Pinhole, ThinLens, View

__all__ = [
    "JPEG",
    "SRGB",
    "AmbientLight",
    "AnnularAperture",
    "Aperture",
    "ArrheniusDarkCurrent",
    "Banding",
    "Bilateral",
    "Box",
    "Camera",
    "ChargeTransfer",
    "CircularAperture",
    "ColourFilter",
    "DarkCurrent",
    "Demosaicing",
    "Denoising",
    "Development",
    "Diffraction",
    "Disc",
    "Distortion",
    "DoublingDarkCurrent",
    "FastPoissonShotNoise",
    "Filmic",
    "Gamma",
    "GaussianShotNoise",
    "GreyWorld",
    "HeavyTailedReadNoise",
    "HotPixels",
    "Light",
    "Material",
    "NeutralPatch",
    "NonLocalMeans",
    "Orthographic",
    "PhotonConversion",
    "Pinhole",
    "PixelAperture",
    "Plane",
    "PoissonShotNoise",
    "PolygonalAperture",
    "Quad",
    "RectangularAperture",
    "Reinhard",
    "ResetNoise",
    "Rim",
    "RollingShutter",
    "Scene",
    "Sensor",
    "Shape",
    "ShotNoise",
    "Sphere",
    "Surface",
    "TelegraphNoise",
    "ThinLens",
    "ToneCurve",
    "ToneEncoding",
    "ToneMap",
    "TriangleMesh",
    "UnsharpMask",
    "View",
    "WhiteBalance",
    "WhiteBalancing",
]
