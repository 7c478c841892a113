# What `fitting.checks` offers, each name where it is defined; see `fitting/__init__.pyi`.

from . import (
    joint as joint,
    noise as noise,
    reflectance as reflectance,
    response as response,
)
