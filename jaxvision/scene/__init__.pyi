# What `jaxvision.scene` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .camera import Camera as Camera
from .developments import (
    JPEG as JPEG,
    SRGB as SRGB,
    Bilateral as Bilateral,
    Demosaicing as Demosaicing,
    Denoising as Denoising,
    Development as Development,
    Filmic as Filmic,
    Gamma as Gamma,
    GreyWorld as GreyWorld,
    NeutralPatch as NeutralPatch,
    NonLocalMeans as NonLocalMeans,
    Reinhard as Reinhard,
    ToneCurve as ToneCurve,
    ToneEncoding as ToneEncoding,
    ToneMap as ToneMap,
    UnsharpMask as UnsharpMask,
    WhiteBalance as WhiteBalance,
    WhiteBalancing as WhiteBalancing,
)
from .lenses import (
    AnnularAperture as AnnularAperture,
    Aperture as Aperture,
    CircularAperture as CircularAperture,
    Diffraction as Diffraction,
    Distortion as Distortion,
    PolygonalAperture as PolygonalAperture,
    RectangularAperture as RectangularAperture,
    Rim as Rim,
    Wavefront as Wavefront,
)
from .light import AmbientLight as AmbientLight, Light as Light
from .maps import Map as Map
from .noises import (
    ArrheniusDarkCurrent as ArrheniusDarkCurrent,
    Banding as Banding,
    DarkCurrent as DarkCurrent,
    DoublingDarkCurrent as DoublingDarkCurrent,
    FastPoissonShotNoise as FastPoissonShotNoise,
    GaussianShotNoise as GaussianShotNoise,
    HeavyTailedReadNoise as HeavyTailedReadNoise,
    HotPixels as HotPixels,
    PoissonShotNoise as PoissonShotNoise,
    ResetNoise as ResetNoise,
    ShotNoise as ShotNoise,
    TelegraphNoise as TelegraphNoise,
)
from .sensor_effects import (
    Compression as Compression,
    Mixing as Mixing,
    Nonlinearity as Nonlinearity,
    ResponseSpline as ResponseSpline,
    ResponseTable as ResponseTable,
    SensorEffect as SensorEffect,
)
from .sensors import (
    BrighterFatter as BrighterFatter,
    ChargeTransfer as ChargeTransfer,
    ColourFilter as ColourFilter,
    PhotonConversion as PhotonConversion,
    PixelAperture as PixelAperture,
    RollingShutter as RollingShutter,
    Sensor as Sensor,
    ShutterOffset as ShutterOffset,
    Taps as Taps,
)
from .shapes import (
    Box as Box,
    Disc as Disc,
    Plane as Plane,
    Quad as Quad,
    Shape as Shape,
    Sphere as Sphere,
    TriangleMesh as TriangleMesh,
)
from .surfaces import Material as Material, Scene as Scene, Surface as Surface
from .views import (
    Orthographic as Orthographic,
    Pinhole as Pinhole,
    ThinLens as ThinLens,
    View as View,
)
