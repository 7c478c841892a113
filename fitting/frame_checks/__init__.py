"""Checks, run before any fit, that find frames which deviate from other frames of the same
light."""
