# What `jaxvision.colour_spaces` offers, each name where it is defined; see
# `jaxvision/__init__.pyi`.

from . import colour_data as colour_data
from .colour_data import (
    camera_sensitivities as camera_sensitivities,
    chart_reflectances as chart_reflectances,
    cone_matrix as cone_matrix,
    daylight_basis as daylight_basis,
    illuminant as illuminant,
    luma_weights as luma_weights,
    nanometres as nanometres,
    observer as observer,
    rgb_basis as rgb_basis,
    rgb_to_xyz_matrix as rgb_to_xyz_matrix,
    wavelength_grid as wavelength_grid,
    white_point as white_point,
)
from ._components import Colours as Colours
from .chromaticity import (
    xyy_to_xyz as xyy_to_xyz,
    xyz_to_xyy as xyz_to_xyy,
)
from .cie_1976 import (
    from_lch as from_lch,
    lab_to_xyz as lab_to_xyz,
    luv_to_xyz as luv_to_xyz,
    to_lch as to_lch,
    xyz_to_lab as xyz_to_lab,
    xyz_to_luv as xyz_to_luv,
)
from .differences import (
    delta_e_2000 as delta_e_2000,
    delta_e_76 as delta_e_76,
)
from .hexagon import (
    hsl_to_rgb as hsl_to_rgb,
    hsv_to_rgb as hsv_to_rgb,
    rgb_to_hsl as rgb_to_hsl,
    rgb_to_hsv as rgb_to_hsv,
)
from .matrices import (
    adapt as adapt,
    apply_matrix as apply_matrix,
    change_rgb_space as change_rgb_space,
    luminance as luminance,
    rgb_to_xyz as rgb_to_xyz,
    xyz_to_rgb as xyz_to_rgb,
)
from .ycbcr import (
    rgb_to_ycbcr as rgb_to_ycbcr,
    ycbcr_to_rgb as ycbcr_to_rgb,
)
