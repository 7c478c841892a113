"""Whether intervals hold the truth as often as they say: simulated data, fitted again and again."""
