"""Reflectance models, one file per family, and the functions that serve every family.

The file of a family contains its record and its equations, and registers them. No other code
depends on the family. `register` adds a record that a user defines. In the local frame the normal
is +z. `wi` is the unit vector toward the light, and `wo` the unit vector toward the viewer. All
functions are for one point; use `jax.vmap` for many. A spectrum has the shape (bands,), or (1,) if
it is the same for all bands.

    evaluate   f_r in sr^-1, 0 where either direction lies below the surface
    sample     a direction `wi` from three uniform numbers, near where f_r is large
    pdf        the density of `sample` in sr^-1, over the whole sphere; samples below the surface
               reflect nothing
    albedo     integral of f_r cos(theta_i) over wi
    shading    f_r cos(theta_i), which multiplies the irradiance of a surface that FACES the light

The BRDFs of mirrors and glass are delta functions, which have no density. `register_delta`
registers such a family. A `Specular` contains the directions in which a ray continues.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
