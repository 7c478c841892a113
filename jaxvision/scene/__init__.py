"""The records that describe a scene and a camera: lights, surfaces, views, sensors, development.

Records contain numbers and have no behaviour. Every record is an immutable pytree. Leaves that are
not static are arrays, which keep the caller's floating dtype. An effect that is absent is `None`
and is never traced. Only shapes, types and choices of algorithm are static, so a sweep over
exposure, gain or bit depth compiles once. All units are SI; world axes are right-handed. Docstrings
state the shapes of a single record. A batch is a record whose leaves are stacked along a leading
axis, for `vmap`. A wrong shape raises `ValueError`.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
