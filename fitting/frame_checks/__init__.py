"""Frames that should be alike, compared with each other before anything is fitted to them."""
