"""Radiosity: the light that diffuse surfaces exchange, computed on a division of the surfaces into
patches.

plan = plan_patches(scene, size=0.1)          chooses the number of patches, outside `jit`
table = form_factor_table(scene, plan)        form factors, computed once for fixed geometry
solution = radiosity(scene, plan, table=table)
image = radiosity_image(scene, plan, solution, view)
"""

from ...core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
