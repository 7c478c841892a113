"""The prediction of frames by a camera file, compared with the frames."""
