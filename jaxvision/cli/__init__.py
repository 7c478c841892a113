"""The command `jaxvision`; `command_line` is the part that the commands of both packages share."""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
