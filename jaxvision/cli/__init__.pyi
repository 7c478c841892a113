# What `jaxvision.cli` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from ._commands import app as app, start as start
