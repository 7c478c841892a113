# What `jaxvision.colour_spaces` offers, each name where it is defined; see
# `jaxvision/__init__.pyi`.

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
