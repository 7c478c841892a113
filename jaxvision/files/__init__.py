"""Read and write files.

- `images` reads and writes images, `raw` reads raw and FITS files, and `image_settings` reads the
  metadata of image files.
- `scenes`, `cameras` and `materials` read and write records as TOML tables, with the modules
  `records` and `toml`.
- `meshes`, `gltf` and `measured` read meshes and measured BRDFs of other programs.
- `shipped` finds the cameras and scenes that come with the package.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
