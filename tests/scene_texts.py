"""Scene files that several tests read, as text."""

BALL = """
[camera]
kind = "pinhole"
position = [0, -4, 0.5]
target = [0, 0, 0]
resolution = [6, 8]
field_of_view = 50

[material.grey]
family = "lambert"
albedo = [0.2, 0.2, 0.2]

[[surface]]
shape = "sphere"
centre = [0, 0, 0]
radius = 1
material = "grey"

[[light]]
kind = "point"
position = [1, -2, 3]
intensity = [10, 10, 10]
"""
