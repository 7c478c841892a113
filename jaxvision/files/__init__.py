"""Read and write files.

images raw image_settings   images, raw files, and their metadata
scenes cameras materials    records as TOML tables, by `records` and `toml`
meshes gltf measured        meshes and measured BRDFs from other programs
shipped                     the cameras and scenes that come with the package
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
