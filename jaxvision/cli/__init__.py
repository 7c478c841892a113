"""The command `jaxvision`, and common parts of the commands of both packages (`command_line`)."""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
