"""The data sheet of EMVA Standard 1288, release 4.0 (2021): both modules, *Linear* and *General*,
with intervals."""
