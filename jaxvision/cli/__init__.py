"""The command `jaxvision`, and what the commands of both packages share (`command_line`)."""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
