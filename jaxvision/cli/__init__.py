"""The shell command `jaxvision`. The module `command_line` is shared with the shell commands of the
package `fitting`."""

from ..core.lazy_names import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
