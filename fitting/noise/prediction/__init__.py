"""What a camera file says of frames, beside what these frames show."""
