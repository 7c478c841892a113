"""Comparison of frames that should be equal, before anything is fitted to them."""
