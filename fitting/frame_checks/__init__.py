"""Comparison of frames that should agree, before any fit."""
