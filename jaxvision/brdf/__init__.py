"""Reflectance models, one file per family, and the functions that serve every family.

A family's file contains its record and its equations, and registers them. No other code knows the
family. `register` does the same for a record that a user defines. In the local frame the normal is
+z. `wi` points toward the light and `wo` toward the viewer, both unit. All functions are for one
point, and the caller vmaps. A spectrum is (bands,), or (1,) if it is neutral and broadcasts.

    evaluate   f_r in sr^-1, 0 where either direction lies below the surface
    sample     a direction `wi` from three uniform numbers, near where f_r is large
    pdf        the density of `sample` in sr^-1, over the whole sphere; samples below the surface
               reflect nothing
    albedo     integral of f_r cos(theta_i) over wi
    shading    f_r cos(theta_i), which multiplies the irradiance of a surface that FACES the light

Mirrors and glass are delta functions without a density. `register_delta` registers their families,
whose `Specular` gives the direction in which a ray continues.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
