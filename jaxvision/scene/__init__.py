"""The records of a scene and a camera: light, surfaces, views, sensors, development.

Records hold numbers and have no behaviour. Every record is a frozen pytree. Non-static leaves are
arrays that keep the caller's floating dtype; an effect that is absent is `None` and is never
traced. Only shapes, types and choices of algorithm are static, so a sweep over exposure, gain or
bit depth compiles once. SI units throughout; world axes are right-handed. The shapes in the
docstrings are those of one record: a batch is a record whose leaves are stacked along a leading
axis, for `vmap`. A wrong shape raises `ValueError`.
"""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
