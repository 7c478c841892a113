"""How surfaces reflect, one file per family, and the functions that serve every family.

A family's file holds its record and its equations and registers them; nothing else needs to know.
`register` does the same for a record of the user's own. In the local frame the normal is +z;
`wi` points toward the light, `wo` toward the viewer, both unit; all of this is for one point, and
the caller vmaps. A spectrum is (bands,), or (1,) where it is neutral and broadcasts.

    evaluate   f_r in sr^-1, 0 where either direction lies below the surface
    sample     a direction `wi` from three uniform numbers, near where f_r is large
    pdf        its density in sr^-1, over the whole sphere: what a lobe sends below the surface
               carries no light
    albedo     integral of f_r cos(theta_i) over wi
    shading    what multiplies the irradiance of a surface that FACES the light, f_r cos(theta_i)

Mirrors and glass are delta functions, which no density describes: `register_delta` enters their
families, whose `Specular` says where a ray goes on.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
