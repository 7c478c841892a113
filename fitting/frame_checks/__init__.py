"""Checks before any fit that find frames which deviate from others of the same light."""
