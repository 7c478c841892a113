"""Test of a camera file: the prediction of frames by the camera, compared with the frames."""
