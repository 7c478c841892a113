# What `import jaxvision` offers, each name where it is defined: read by type checkers, and by
# `__init__.py`, which loads a name when it is first used.

__version__: str

from . import (
    accuracy as accuracy,
    brdf as brdf,
    colour_spaces as colour_spaces,
    development as development,
    effects as effects,
    errors as errors,
    files as files,
    filters as filters,
    geometry as geometry,
    histogram as histogram,
    lights as lights,
    matting as matting,
    optics as optics,
    plots as plots,
    point_ops as point_ops,
    rendering as rendering,
    scene as scene,
    sensor as sensor,
    spectra as spectra,
    tasks as tasks,
    transport as transport,
)
from .core._numerics import (
    angle_between as angle_between,
    dot as dot,
    log_cos_between as log_cos_between,
    norm as norm,
    normalize as normalize,
    safe_sqrt as safe_sqrt,
)
from .core._types import (
    ArrayLike as ArrayLike,
    Colour as Colour,
    Image as Image,
    Key as Key,
    Scalar as Scalar,
    Scalars as Scalars,
    Spectrum as Spectrum,
    as_dtype as as_dtype,
    as_float as as_float,
    as_optional_float as as_optional_float,
)
from .core._vector import (
    Vec as Vec,
    Vec3 as Vec3,
    Vector as Vector,
    as_array as as_array,
    as_vec as as_vec,
)
from .brdf import (
    reflect as reflect,
)
from .brdf.blinn import (
    Blinn as Blinn,
    BlinnBRDF as BlinnBRDF,
    NormalisedBlinn as NormalisedBlinn,
)
from .brdf.coated import (
    Coated as Coated,
)
from .brdf.dichromatic import (
    Dichromatic as Dichromatic,
)
from .brdf.dichromatic_separation import (
    Separation as Separation,
    separate as separate,
)
from .brdf.fresnel import (
    Conductor as Conductor,
    Dielectric as Dielectric,
    Schlick as Schlick,
)
from .brdf.eon import (
    EON as EON,
)
from .brdf.gaussian_lobe import (
    GaussianLobe as GaussianLobe,
    GaussianLobeBRDF as GaussianLobeBRDF,
    gaussian_lobe as gaussian_lobe,
    gaussian_lobe_shading as gaussian_lobe_shading,
)
from .brdf.glass import (
    Glass as Glass,
)
from .brdf.half_difference import (
    HalfDifferenceTable as HalfDifferenceTable,
)
from .brdf.lambert import (
    Lambert as Lambert,
    lambert_shading as lambert_shading,
)
from .brdf.measured import (
    AnisotropicTable as AnisotropicTable,
    BRDFSamples as BRDFSamples,
    IsotropicTable as IsotropicTable,
    sample_directions as sample_directions,
    samples_of as samples_of,
)
from .brdf.mirror import (
    Mirror as Mirror,
)
from .brdf.oren_nayar import (
    OrenNayar as OrenNayar,
)
from .brdf.phong import (
    NormalisedPhong as NormalisedPhong,
    Phong as Phong,
    PhongBRDF as PhongBRDF,
    phong_lobe as phong_lobe,
    phong_shading as phong_shading,
)
from .brdf.rgl import (
    RGL as RGL,
)
from .brdf.torrance_sparrow import (
    TorranceSparrow as TorranceSparrow,
)
from .files.cameras import (
    read_camera as read_camera,
    read_sensor as read_sensor,
    write_camera as write_camera,
    write_sensor as write_sensor,
    shipped_cameras as shipped_cameras,
)
from .sensor.colour_filters import (
    bayer as bayer,
    mosaic as mosaic,
)
from .development import (
    camera_colour as camera_colour,
    demosaic as demosaic,
    develop as develop,
    fit_colour_matrix as fit_colour_matrix,
    jpeg as jpeg,
    to_integers as to_integers,
    tone_curve as tone_curve,
    white_balance as white_balance,
)
from .errors import (
    InputError as InputError,
)
from .geometry import (
    Encounter as Encounter,
    Hit as Hit,
    Ray as Ray,
    hit_shape as hit_shape,
    intersect as intersect,
    mirror_direction as mirror_direction,
    nearest_shape as nearest_shape,
    occluded as occluded,
    offset_origin as offset_origin,
)
from .geometry.hemisphere import (
    Frame as Frame,
    local_frame as local_frame,
    to_local as to_local,
    to_world as to_world,
)
from .rendering.hemisphere_integral import (
    Estimate as Estimate,
    hemisphere_radiance as hemisphere_radiance,
    lit_radiance as lit_radiance,
    sampled_radiance as sampled_radiance,
)
from .rendering.lifted_scene import (
    lift_scene as lift_scene,
)
from .lights import (
    Balanced as Balanced,
    DirectionalLight as DirectionalLight,
    EnvironmentMap as EnvironmentMap,
    GoniometricAreaLight as GoniometricAreaLight,
    GoniometricLight as GoniometricLight,
    Incident as Incident,
    LightFieldLight as LightFieldLight,
    Luminaire as Luminaire,
    MonteCarlo as MonteCarlo,
    PointLight as PointLight,
    Quadrature as Quadrature,
    RectangleLight as RectangleLight,
    SmallLight as SmallLight,
    SpotLight as SpotLight,
    SunDisc as SunDisc,
    Window as Window,
    environment_map as environment_map,
    goniometric_light as goniometric_light,
    incident as incident,
    incident_samples as incident_samples,
    irradiance as irradiance,
)
from .lights.adaptive import (
    adaptive_irradiance as adaptive_irradiance,
)
from .lights.light_field import (
    refocus as refocus,
)
from .lights.orders import (
    order_for as order_for,
)
from .lights.polygon import (
    rectangle_irradiance as rectangle_irradiance,
)
from .files.materials import (
    read_material as read_material,
    write_material as write_material,
)
from .files.measured import (
    read_measured as read_measured,
)
from .files.images import read_image as read_image, write_image as write_image
from .core.memory import keep_memory as keep_memory
from .optics import (
    camera_ray as camera_ray,
    circle_of_confusion as circle_of_confusion,
    depth_of_field as depth_of_field,
    gather_defocus as gather_defocus,
    hyperfocal_distance as hyperfocal_distance,
    image_distance as image_distance,
    layered_defocus as layered_defocus,
    lens_ray as lens_ray,
    look_at as look_at,
    project as project,
    sensor_irradiance as sensor_irradiance,
    view_ray as view_ray,
)
from .point_ops import (
    gain_bias as gain_bias,
    gamma_decode as gamma_decode,
    gamma_encode as gamma_encode,
    srgb_decode as srgb_decode,
    srgb_encode as srgb_encode,
)
from .rendering import (
    Edges as Edges,
    PixelSamples as PixelSamples,
    radiance_along as radiance_along,
    render as render,
    render_light_field as render_light_field,
)
from .scene import (
    JPEG as JPEG,
    SRGB as SRGB,
    AmbientLight as AmbientLight,
    AnnularAperture as AnnularAperture,
    ArrheniusDarkCurrent as ArrheniusDarkCurrent,
    Banding as Banding,
    Bilateral as Bilateral,
    Box as Box,
    Camera as Camera,
    BrighterFatter as BrighterFatter,
    ChargeTransfer as ChargeTransfer,
    CircularAperture as CircularAperture,
    ColourFilter as ColourFilter,
    Compression as Compression,
    Demosaicing as Demosaicing,
    Development as Development,
    Diffraction as Diffraction,
    Disc as Disc,
    Distortion as Distortion,
    DoublingDarkCurrent as DoublingDarkCurrent,
    FastPoissonShotNoise as FastPoissonShotNoise,
    Filmic as Filmic,
    Gamma as Gamma,
    GaussianShotNoise as GaussianShotNoise,
    GreyWorld as GreyWorld,
    HeavyTailedReadNoise as HeavyTailedReadNoise,
    HotPixels as HotPixels,
    Light as Light,
    Map as Map,
    Material as Material,
    Mixing as Mixing,
    NeutralPatch as NeutralPatch,
    NonLocalMeans as NonLocalMeans,
    Nonlinearity as Nonlinearity,
    Orthographic as Orthographic,
    PhotonConversion as PhotonConversion,
    Pinhole as Pinhole,
    PixelAperture as PixelAperture,
    Plane as Plane,
    PoissonShotNoise as PoissonShotNoise,
    PolygonalAperture as PolygonalAperture,
    Quad as Quad,
    RectangularAperture as RectangularAperture,
    Reinhard as Reinhard,
    ResetNoise as ResetNoise,
    ResponseSpline as ResponseSpline,
    ResponseTable as ResponseTable,
    Rim as Rim,
    RollingShutter as RollingShutter,
    Scene as Scene,
    Sensor as Sensor,
    SensorEffect as SensorEffect,
    ShutterOffset as ShutterOffset,
    Sphere as Sphere,
    Surface as Surface,
    Taps as Taps,
    TelegraphNoise as TelegraphNoise,
    ThinLens as ThinLens,
    ToneCurve as ToneCurve,
    TriangleMesh as TriangleMesh,
    UnsharpMask as UnsharpMask,
    Wavefront as Wavefront,
    WhiteBalance as WhiteBalance,
)
from .sensor import (
    Calibrated as Calibrated,
    Master as Master,
    Masters as Masters,
    Moments as Moments,
    clipped_moments as clipped_moments,
    collect as collect,
    correct as correct,
    digitise as digitise,
    expected_signal as expected_signal,
    exposed as exposed,
    mean_photoelectrons as mean_photoelectrons,
    pattern_variance as pattern_variance,
    photon_rate as photon_rate,
    raw_image as raw_image,
    signal_variance as signal_variance,
)
from .rendering.maps import (
    material_at as material_at,
)
from .rendering.shading import (
    outgoing_radiance as outgoing_radiance,
)
from .rendering.shadows import (
    Leaving as Leaving,
    visibility as visibility,
)
from .shot import (
    Capture as Capture,
    capture as capture,
)
from .tasks import (
    cluster as cluster,
)
from .transport import (
    Paths as Paths,
    Traced as Traced,
    light_traced as light_traced,
    path_radiance as path_radiance,
    path_traced as path_traced,
    path_traced_pixels as path_traced_pixels,
    ray_traced as ray_traced,
)
