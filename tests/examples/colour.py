"""Calls for conversions between colour spaces, with colours that are neither grey nor at the
discontinuity of the hue."""

import jax.numpy as jnp

RGB = jnp.asarray([[0.2, 0.5, 0.7], [0.8, 0.3, 0.1]])
XYZ = jnp.asarray([[0.3, 0.25, 0.5], [0.02, 0.03, 0.004]])
LAB = jnp.asarray([[40.0, 20.0, -30.0], [70.0, -15.0, 25.0]])
OTHER = jnp.asarray([[45.0, 10.0, -20.0], [66.0, -20.0, 40.0]])
WHITE, WARM = jnp.asarray([0.95, 1.0, 1.09]), jnp.asarray([1.1, 1.0, 0.36])
MATRIX = jnp.asarray([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]])

EXAMPLES = {
    "colour_spaces.matrices.apply_matrix": ((RGB, MATRIX), {}),
    "colour_spaces.matrices.rgb_to_xyz": ((RGB,), {"space": "ITU-R BT.2020"}),
    "colour_spaces.matrices.xyz_to_rgb": ((XYZ,), {}),
    "colour_spaces.matrices.luminance": ((RGB,), {}),
    "colour_spaces.matrices.adapt": ((XYZ, WHITE, WARM), {"method": "CAT02"}),
    "colour_spaces.matrices.change_rgb_space": (
        (RGB,),
        {"source": "sRGB", "target": "ProPhoto RGB"},
    ),
    "colour_spaces.chromaticity.xyz_to_xyy": ((XYZ,), {}),
    "colour_spaces.chromaticity.xyy_to_xyz": ((XYZ,), {}),
    "colour_spaces.cie_1976.xyz_to_lab": ((XYZ, WHITE), {}),
    "colour_spaces.cie_1976.lab_to_xyz": ((LAB, WHITE), {}),
    "colour_spaces.cie_1976.xyz_to_luv": ((XYZ, WHITE), {}),
    "colour_spaces.cie_1976.luv_to_xyz": ((LAB, WHITE), {}),
    "colour_spaces.cie_1976.to_lch": ((LAB,), {}),
    "colour_spaces.cie_1976.from_lch": ((LAB / 20,), {}),
    "colour_spaces.differences.delta_e_76": ((LAB, OTHER), {}),
    "colour_spaces.differences.delta_e_2000": ((LAB, OTHER), {}),
    "colour_spaces.hexagon.rgb_to_hsv": ((RGB,), {}),
    "colour_spaces.hexagon.hsv_to_rgb": ((RGB,), {}),
    "colour_spaces.hexagon.rgb_to_hsl": ((RGB,), {}),
    "colour_spaces.hexagon.hsl_to_rgb": ((RGB,), {}),
    "colour_spaces.ycbcr.rgb_to_ycbcr": ((RGB,), {"levels": "legal"}),
    "colour_spaces.ycbcr.ycbcr_to_rgb": ((RGB,), {"levels": "legal", "bits": 10}),
}
