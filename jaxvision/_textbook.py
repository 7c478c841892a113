"""A table of textbook terms and the names they have in this library. Error messages about unknown
names use this table, and `docs/notions.md` lists it.

A target, the name in this library, that has a dot is a public name below `jaxvision` or `fitting`.
A target without a dot is a public name of `jaxvision`, a field of a record, an argument, or a key
of a file.
"""

import difflib
import re
from collections.abc import Iterable

_WORDS = {
    # light
    "point_source": "PointLight",
    "sun sunlight parallel_light distant_light": "DirectionalLight",
    "area_source area_light": "RectangleLight irradiance",
    "light_field": "LightFieldLight render_light_field",
    "sky skydome ibl": "environment_map",
    "black_body planck": "spectra.blackbody",
    "L_a ambient_radiance ambient_reflection": "AmbientLight ambient radiance",
    "I": "intensity",
    "E": "irradiance",
    "L": "radiance",
    "solid_angle": "sample_directions hemisphere_radiance",
    "umbra penumbra half_shadow": "visibility RectangleLight",
    "spectral_radiance": "outgoing_radiance spectra.blackbody",
    # reflectance
    "v_i light_direction": "wi",
    "v_r view_direction viewer": "wo",
    "k_d kd rho base_colour": "diffuse albedo",
    "albedo": "diffuse",
    "radiant_intensity luminous_intensity candela": "PointLight lights.relative_intensity",
    "luminous_flux radiant_flux lumen": "lights.flux",
    "illuminance lux": "irradiance files.read_luminaire",
    "radiant_exitance exitance": "transport.radiosity.radiosity",
    "brdf reflectance_function bidirectional_reflectance": (
        "brdf.evaluate brdf.families Lambert PhongBRDF TorranceSparrow"
    ),
    "bsdf btdf transmission": "brdf.evaluate Glass",
    "fresnel fresnel_equations": "Dielectric Conductor Schlick",
    "snell snells_law refraction": "Glass eta",
    "k_s ks": "specular",
    "k_e ke n_s shininess specular_exponent": "exponent",
    "k_a ka": "ambient",
    "c_s": "concentration",
    "ior refractive_index n_2": "eta index",
    "alpha_roughness": "roughness",
    "alpha": "roughness matting.composite",
    "lambertian diffuse_surface": "Lambert lambert_shading",
    "foreshortening foreshortened_area": "lambert_shading irradiance",
    "specular_direction reflection_direction v_s": "mirror_direction",
    "gaussian_torrance_sparrow": "GaussianLobe",
    "specular_lobe": "phong_lobe gaussian_lobe",
    "microfacet cook_torrance ggx": "TorranceSparrow",
    "blinn_phong half_vector": "Blinn BlinnBRDF",
    "dichromatic_model shafer": "Dichromatic separate",
    "rendering_equation reflectance_equation": "outgoing_radiance hemisphere_radiance",
    "shadow cast_shadow": "visibility occluded",
    "ray_tracing": "ray_traced",
    "path_tracing global_illumination": "path_traced Paths",
    "interreflection interreflections": "path_traced transport.radiosity.radiosity",
    "form_factor view_factor radiosity_equation": "transport.radiosity.form_factor_table",
    "caustic caustics": "light_traced",
    "russian_roulette": "Paths",
    "photometric_stereo shape_from_shading": "reflectance.photometric_stereo",
    # lens
    "perspective projection": "Pinhole project",
    "lens_law lens_equation thin_lens_equation gauss_lens": "image_distance",
    "z_o object_dist": "object_distance",
    "z_i": "image_distance",
    "f focal": "focal_length",
    "f_stop fstop aperture_number n_stop": "f_number",
    "aperture": "f_number CircularAperture PolygonalAperture",
    "dof": "depth_of_field",
    "depth_of_focus": "image_distance circle_of_confusion",
    "fov": "field_of_view",
    "blur_disc coc": "circle_of_confusion",
    "vignetting vignette cos4 falloff": "sensor_irradiance Rim point_ops.vignette",
    "chromatic_aberration": "optics.chromatic_defocus Distortion",
    "airy airy_disk point_spread_function psf": "optics.airy_pattern Diffraction",
    "mtf otf modulation_transfer_function": "resolution.from_edge optics.diffraction_mtf",
    "sfr slanted_edge sharpness": "resolution.from_edge",
    "bokeh": "gather_defocus CircularAperture PolygonalAperture",
    "homography": "project filters.warp",
    "intrinsics extrinsics": "optics.opencv_view",
    "aberration coma astigmatism spherical_aberration strehl": "Wavefront optics.zernike",
    # sensor
    "ccd cmos image_sensor charge_coupled_device": "Sensor read_camera",
    "shutter exposure shutter_time shutter_speed": "exposure_time",
    "motion_blur": "capture RollingShutter",
    "chip_size sensor_size": "optics.chip_size",
    "pixel_size sampling_pitch pitch": "pixel_pitch",
    "fill_factor aliasing antialiasing moire": "PixelAperture sensor.aperture_mtf",
    "sampling": "PixelAperture PixelSamples",
    "iso analog_gain analogue_gain": "sensor.set_iso gain",
    "black_level": "offset",
    "qe quantum_yield": "quantum_efficiency",
    "photon_noise poisson_noise": "shot_noise PoissonShotNoise",
    "fixed_pattern_noise fpn": "dsnu prnu pattern_variance",
    "snr": "sensor.signal_to_noise",
    "dynamic_range": "sensor.signal_to_noise noise.calibrate",
    "gain_error": "prnu",
    "adc quantise quantization bit_depth": "bits digitise",
    "full_well_capacity anti_blooming": "full_well blooming",
    "bucket_brigade cte": "ChargeTransfer charge_transfer",
    "thermal_noise dark_signal": "dark_current",
    "dark_noise": "read_noise dark_current",
    "flat_field flat_fielding dark_frame": "correct",
    "dead_pixel defect salt_and_pepper impulse_noise": "HotPixels dead_pixels",
    "photon_transfer emva usable_bits": "noise.from_frames noise.calibrate",
    "emva_1288_release_4 dsnu_of_rows spectrogram defect_pixels": (
        "noise.read_stacks noise.release_4_sheet"
    ),
    # from raw numbers to a picture
    "bayer_pattern cfa colour_filter_array": "bayer mosaic",
    "debayer demosaicing": "demosaic",
    "white_point wb": "white_balance",
    "gamma gamma_correction": "gamma_encode gamma_decode",
    "srgb": "srgb_encode srgb_decode",
    "compression": "jpeg",
    "dsp isp pipeline": "develop",
    "response_function camera_response crf hdr": "response.from_stack",
    # point operators
    "brightness contrast bias": "gain_bias",
    "tonemap tone_mapping": "point_ops.reinhard point_ops.filmic",
    "lerp linear_blend alpha_blend": "point_ops.blend",
    "dissolve crossfade": "point_ops.cross_dissolve",
    "grayscale to_gray rgb2gray grey luma": "colour_spaces.luminance",
    "color_space": "colour_spaces.change_rgb_space colour_spaces.rgb_to_xyz",
    "cie_xyz xyz": "colour_spaces.rgb_to_xyz",
    "metamerism metamer": "colour_spaces.observer spectra.rgb_to_reflectance",
    "lab cielab": "colour_spaces.xyz_to_lab",
    "hsv": "colour_spaces.rgb_to_hsv",
    "color_transform": "colour_spaces.apply_matrix",
    "compositing porter_duff alpha_blending": "matting.over matting.composite",
    "matte": "Lambert matting.closed_form_matte matting.blue_screen_matte",
    "alpha_matte keying": "matting.closed_form_matte matting.blue_screen_matte",
    "chroma_key chroma_keying blue_screen green_screen": "matting.blue_screen_matte",
    "alpha_channel premultiplied_alpha": "matting.premultiply matting.composite",
    "trimap": "matting.closed_form_matte",
    "hist": "histogram.exact_histogram",
    "cdf cumulative": "histogram.cumulative_distribution",
    "equalize equalize_hist histeq histogram_equalization": "histogram.equalise",
    "histogram_matching histogram_specification": "histogram.match_histogram",
    "thresholding threshold otsu": "histogram.otsu_threshold",
    "clahe adaptive_equalization": "histogram.equalise_locally",
    "inspection image_inspection": "plots.inspect",
    # filters
    "convolution convolve2d conv": "filters.convolve",
    "correlation cross_correlation filter2d": "filters.correlate",
    "fourier fft transfer_function": "optics.diffraction_mtf filters.impulse_response",
    "impulse delta": "filters.impulse_response",
    "padding pad pad_mode boundary": "border filters.pad",
    "border_mode": "border filters.pad",
    "separable sepfilter2d": "filters.correlate_separable",
    "blur gaussian_blur smooth": "filters.gaussian",
    "box_filter box_blur": "filters.box",
    "sharpen sharpening": "filters.unsharp_mask UnsharpMask",
    "bicubic bilinear": "filters.resize",
    "sobel gradient_filter": "filters.Gradient",
    "log_filter": "filters.laplacian_of_gaussian",
    "steerable": "filters.steer",
    "summed_area_table": "filters.integral_image",
    "space_variant shift_variant": "filters.convolve_per_pixel filters.gaussian_varying",
    "toeplitz convolution_matrix": "filters.filter_matrix",
    "image_pyramid pyramid": "filters.gaussian_pyramid filters.laplacian_pyramid",
    "median": "filters.median_filter",
    "ksize kernel_size": "size",
    # estimation
    "least_squares curve_fit maximum_likelihood": "fit",
}
ABSENT = frozenset({"flare", "glare", "lensflare", "veilingglare", "polarisation", "fluorescence"})
_OF_FITTING = ("noise", "reflectance", "resolution", "response")
_SPELT = {"color": "colour", "gray": "grey", "center": "centre", "analog": "analogue"}


def folded(word: str) -> str:
    """Return a word in lower case and British spelling, without underscores and hyphens."""
    plain = re.sub(r"[\W_]", "", word).casefold()
    for american, british in _SPELT.items():
        plain = re.sub(rf"{american}(?!ue)", british, plain)
    return re.sub(r"iz(?=e|ing|ation)", "is", plain)


TARGETS = {
    folded(word): tuple(targets.split())
    for words, targets in _WORDS.items()
    for word in words.split()
}


def is_absent(word: str) -> bool:
    """Return whether a textbook's word names an effect that the library does not model."""
    return folded(word) in ABSENT


def meant(word: str, known: Iterable[str]) -> tuple[str, ...]:
    """Return the names in `known` for a textbook's word; often there are none."""
    names = set(known)
    return tuple(name for name in TARGETS.get(folded(word), ()) if name in names)


def similar(word: str, known: Iterable[str]) -> tuple[str, tuple[str, ...]] | None:
    """Return the textbook's word nearest to a misspelt word, and its names in `known`; None if no
    word is near."""
    names = {
        one: found
        for words in _WORDS
        for one in words.split()
        if len(one) > 3 and (found := meant(one, known))
    }
    near = difflib.get_close_matches(word.casefold(), names, n=1, cutoff=0.85)
    return (near[0], names[near[0]]) if near else None


def places(word: str, offered: Iterable[str]) -> str:
    """Return a phrase that lists the public names and arguments for a textbook's word, or an empty
    string for a word that is not in the table.
    """
    names = set(offered)
    found = [
        f"{'fitting' if name.split('.')[0] in _OF_FITTING else 'jaxvision'}.{name}"
        if "." in name or name in names
        else f"fitting.{name}"
        if name == "fit"
        else f"the argument {name!r}"
        for name in TARGETS.get(folded(word), ())
    ]
    return ", ".join(found[:-1]) + (" or " if found[1:] else "") + "".join(found[-1:])
