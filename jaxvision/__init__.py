"""Photometric image formation as pure JAX functions: from light to digital numbers."""

__version__ = "0.1.0"
