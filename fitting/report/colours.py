"""Colours of figures, to be told apart on white and on black."""

RED, GREEN, BLUE = "#d1495b", "#2e9e5b", "#3b82c4"
OF_CHANNEL = {
    "red": RED,
    "green": GREEN,
    "green 1": GREEN,
    "green 2": "tab:olive",
    "blue": BLUE,
    "grey": "0.5",
}
