"""Digital numbers back to the parameters of light, surface and camera, with honest uncertainty."""
