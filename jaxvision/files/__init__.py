"""Files: images, raw files and what their heads say; cameras, materials and scenes as TOML tables;
meshes and measured BRDFs.

`images`, `raw` and `image_settings` read pictures; `scenes`, `cameras` and `materials` records, by
`records` and `toml`; `meshes`, `gltf` and `measured` what other programs wrote. `shipped` holds the
cameras and scenes that come with the package.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
